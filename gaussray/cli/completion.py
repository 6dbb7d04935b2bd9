"""What a shell needs to complete the words of the command: a script that asks nobody."""

from gaussray.cli.help import VERBS
from gaussray.config.schema import choices, groups, keys
from gaussray.runtime.progress import STYLES


SHELLS = ("bash", "zsh")
# Values of keys that are a few words.
FEW = {"progress": STYLES}
# Keys whose values are names of files.
PATHS = ("capture.path", "out", "scene", "cameras", "truth", "source", "data", "lens.file",
         "trajectory.file")  # fmt: skip

_SCRIPT = """\
# Completion of gaussray for {shell}. To have it in every shell:
#   gaussray --completion {shell} > ~/.gaussray-completion
#   echo 'source ~/.gaussray-completion' >> ~/.{shell}rc
{begin}_gaussray() {{
    local line="${{COMP_LINE:0:$COMP_POINT}}" word verb words="" first one
    word="${{line##* }}"
    read -r _ verb _ <<< "$line "
    COMPREPLY=()
    if [[ "$line" != *" "*" "* ]]; then
        words="{verbs} --help --version --completion"
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
                case "$verb" in
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
    """The script for a shell; ValueError for one that is not known."""
    if shell not in SHELLS:
        raise ValueError(f"--completion must be one of {', '.join(SHELLS)}, got {shell!r}.")
    begin = "autoload -U +X bashcompinit && bashcompinit\n" if shell == "zsh" else ""
    cases = "\n".join(
        f'                    {verb}) words="{" ".join(words(verb))}" ;;' for verb in VERBS
    )
    paths = " | ".join(f"{key}=*" for key in PATHS)
    return _SCRIPT.format(shell=shell, begin=begin, verbs=" ".join(VERBS), cases=cases, paths=paths)


def words(verb: str) -> list[str]:
    """Every word that may follow a verb: keys, with their values where these are few, and choices
    of groups."""
    found = ["--help", "--help=all"]
    for group in groups(verb):
        found += [f"{group}={choice}" for choice in choices(group)]
    for name, key in keys(verb).items():
        switch = ("true", "false") if key.default in ("true", "false") else ("",)
        found += [f"{name}={value}" for value in FEW.get(name, switch)]
    return found
