"""Pictures of one camera are ranges in a message, cameras are not."""

from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.findings.listed_pictures import listed_pictures


def test_pictures_of_a_camera_are_a_range_and_cameras_are_not(placement_of):
    pictures = [MatchingPicture(f"{k}.png", "a", k, (4, 3)) for k in range(5)]
    assert listed_pictures(pictures[1:], placement_of(pictures)) == "a 1 to a 4"
    other = [MatchingPicture(f"b{k}.png", "b", k, (4, 3)) for k in range(3)]
    both = placement_of(pictures + other)
    assert listed_pictures(pictures[2:] + other[:2], both) == "a 2 to a 4, b 0, b 1"
    still = [MatchingPicture(f"{k}.png", f"c{k}", 0, (4, 3)) for k in range(4)]
    placement = placement_of(still, still=frozenset(p.camera for p in still))
    assert listed_pictures(still, placement) == "c0, c1, c2, c3"
