"""What the shell makes of a line that is not finished."""

import shutil
import subprocess

import pytest

from gaussray.cli.completion import FEW_VALUES, PATH_KEYS, SHELLS, script, words
from gaussray.cli.help import COMMANDS
from gaussray.config.schema import choices, groups, keys


def completed(line, breaks=" =:"):
    """The words that bash offers for a line, whose cursor is at its end."""
    ask = f"""COMP_WORDBREAKS={breaks!r}; COMP_LINE={line!r}; COMP_POINT=${{#COMP_LINE}}
    _gaussray; printf '%s\\n' "${{COMPREPLY[@]}}\""""
    bash = ["bash", "--norc", "-c", f"{script('bash')}\n{ask}"]
    done = subprocess.run(bash, capture_output=True, text=True, check=True)
    assert not done.stderr
    return done.stdout.split()


pytestmark = pytest.mark.skipif(not shutil.which("bash"), reason="there is no bash")


def test_commands_come_first():
    assert completed("gaussray re") == ["reconstruct", "render"]
    assert set(COMMANDS) <= set(completed("gaussray "))


def test_groups_come_before_their_keys_and_choices():
    assert completed("gaussray render aper") == ["aperture.", "aperture="]
    assert completed("gaussray render lens.f") == ["lens.file=", "lens.fov=", "lens.fov_y="]
    assert "lens." not in completed("gaussray reconstruct ")


@pytest.mark.parametrize("breaks", [" ", " =:"])
def test_values_are_offered_as_the_shell_replaces_them(breaks):
    before = "" if "=" in breaks else "lens="
    expected = [f"{before}f_theta", f"{before}fisheye"]
    assert completed("gaussray render scene=x lens=f", breaks) == expected


def test_values_that_are_few_are_offered():
    assert completed("gaussray evaluate evaluate.images=") == ["true", "false"]
    assert completed("gaussray render progress=j") == ["json"]


def test_files_are_offered_where_a_key_names_one(tmp_path):
    (tmp_path / "scene.npz").touch()
    (tmp_path / "scenes").mkdir()
    found = completed(f"gaussray render scene={tmp_path}/sc")
    assert sorted(found) == [f"{tmp_path}/scene.npz", f"{tmp_path}/scenes/"]


@pytest.mark.skipif(not shutil.which("zsh"), reason="there is no zsh")
@pytest.mark.parametrize(
    "line", ["gaussray re", "gaussray render aper", "gaussray render lens=equi"]
)
def test_zsh_offers_what_bash_does(line):
    # As bashcompinit calls a function of bash.
    ask = f"""ask() {{ emulate -L sh; setopt kshglob noshglob braceexpand
    COMP_LINE={line!r}; COMP_POINT=${{#COMP_LINE}}; COMPREPLY=()
    _gaussray; printf '%s\\n' "${{COMPREPLY[@]}}"; }}; ask"""
    zsh = ["zsh", "-f", "-c", f"{script('zsh').split('bashcompinit', 2)[2]}\n{ask}"]
    zsh[-1] = zsh[-1].replace("complete -o", "true complete -o")
    done = subprocess.run(zsh, capture_output=True, text=True, check=True)
    assert done.stdout.split() == completed(line, " ")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_key_and_choice_is_a_word(command):
    told = {word.split("=")[0] for word in words(command)}
    assert set(keys(command)) <= told
    for group in groups(command):
        assert {f"{group}={choice}" for choice in choices(group)} <= set(words(command))


def test_paths_and_values_are_those_of_keys():
    known = {name for command in COMMANDS for name in keys(command)}
    assert set(PATH_KEYS) | set(FEW_VALUES) <= known


def test_a_shell_that_is_not_known_is_refused():
    assert all("complete -o nospace" in script(shell) for shell in SHELLS)
    with pytest.raises(ValueError, match="--completion must be one of bash, zsh, got 'csh'"):
        script("csh")
