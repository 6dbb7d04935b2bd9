"""What a run says of where it came from."""

from gaussray.runtime import provenance


def test_the_keys_of_a_command_line_are_known():
    with provenance.command_arguments(["reconstruct", "fit.degree=0", "+out=a=b", "fit=full"]):
        assert provenance.given_keys() == ("fit.degree", "out", "fit")
    assert provenance.given_keys() == ()
