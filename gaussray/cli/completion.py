"""The script for tab completion in bash and zsh. It holds all words and starts no program."""

from gaussray.cli.help import COMMANDS
from gaussray.config.schema import PATH_KEYS, choices, groups, keys
from gaussray.runtime.progress import STYLES


SHELLS = ("bash", "zsh")
# Keys with a few possible values.
FEW_VALUES = {"progress": STYLES}

_SCRIPT = """\
# Completion of gaussray for {shell}. To have it in every shell:
#   gaussray --completion {shell} > ~/.gaussray-completion
#   echo 'source ~/.gaussray-completion' >> ~/.{shell}rc
{begin}_gaussray() {{
    local line="${{COMP_LINE:0:$COMP_POINT}}" word command words="" first one
    word="${{line##* }}"
    read -r _ command _ <<< "$line "
    COMPREPLY=()
    if [[ "$line" != *" "*" "* ]]; then
        words="{commands} --help --version --completion"
    else
        case "$word" in
            {paths})
                local at="${{word%%=*}}=" file path="${{word#*=}}"
                [[ "$path" == "~/"* ]] && path="$HOME/${{path#"~/"}}"
                for file in "$path"*; do
                    [[ -d "$file" ]] && file="$file/"
                    [[ -e "$file" ]] && COMPREPLY+=("$at$file")
                done
                ;;
            *)
                case "$command" in
{cases}
                esac
                ;;
        esac
    fi
    if [[ -n "$words" ]]; then
        # Not compgen: zsh's does not choose.
        for one in $words; do
            [[ "$one" == "$word"* ]] && COMPREPLY+=("$one")
        done
        # First the group, then its keys or its choices: lens. and lens=, and not each of them.
        if [[ "$word" != *=* && ${{#COMPREPLY[@]}} -gt 1 ]]; then
            [[ "$word" == *.* ]] && first="" || first='s/\\.[^=]*=.*/./;'
            COMPREPLY=($(printf '%s\\n' "${{COMPREPLY[@]}}" | sed "$first s/=.*/=/" | sort -u))
        fi
    fi
    # Readline replaces what stands behind the last break, and = and : are breaks.
    local breaks="${{word%"${{word##*[=:]}}"}}"
    if [[ -n "$breaks" && "$COMP_WORDBREAKS" == *"${{breaks: -1}}"* ]]; then
        COMPREPLY=("${{COMPREPLY[@]#"$breaks"}}")
    fi
}}
complete -o nospace -F _gaussray gaussray
"""


def script(shell: str) -> str:
    """The completion script of a shell (bash or zsh); a ValueError for any other."""
    if shell not in SHELLS:
        raise ValueError(f"--completion must be one of {', '.join(SHELLS)}, got {shell!r}.")
    begin = "autoload -U +X bashcompinit && bashcompinit\n" if shell == "zsh" else ""
    cases = "\n".join(
        f'                    {name}) words="{" ".join(words(name))}" ;;' for name in COMMANDS
    )
    paths = " | ".join(f"{key}=*" for key in PATH_KEYS)
    return _SCRIPT.format(
        shell=shell, begin=begin, commands=" ".join(COMMANDS), cases=cases, paths=paths
    )


def words(command: str) -> list[str]:
    """Every word that may follow a command: keys, with their values where these are few, and
    choices of groups."""
    suggestions = ["--help", "--help=all"]
    for group in groups(command):
        suggestions += [f"{group}={choice}" for choice in choices(group)]
    for name, key in keys(command).items():
        switch = ("true", "false") if key.default in ("true", "false") else ("",)
        suggestions += [f"{name}={value}" for value in FEW_VALUES.get(name, switch)]
    return suggestions
