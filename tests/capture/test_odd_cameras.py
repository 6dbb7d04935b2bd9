"""Which cameras explain that some pairs fit and others do not."""

from gaussray.capture.odd_cameras import JudgedPair, odd_cameras


def odd(good="", bad="", matches=150):
    """The cameras that are named, of pairs written as two letters."""
    pairs = {(a, b): JudgedPair(matches, True) for a, b in good.split()}
    return odd_cameras(pairs | {(a, b): JudgedPair(matches, False) for a, b in bad.split()})


def test_the_camera_that_is_common_to_the_bad_pairs_is_named():
    assert odd(good="ab bc ac", bad="ad bd cd") == ["d"]
    assert odd(good="bc", bad="ab ac") == ["a"]
    # The other one of its only pair fits elsewhere.
    assert odd(good="ab bc", bad="cd") == ["d"]


def test_several_cameras_are_named_as_long_as_most_fit():
    assert odd(good="ab bc ca cf", bad="de da eb") == ["d", "e"]
    assert odd(good="ab", bad="ac bc ad bd cd") == []


def test_nothing_is_named_where_all_fit_or_none_does_or_two_are_equally_likely():
    assert odd(good="ab bc ca") == odd() == []
    assert odd(bad="ab bc ca") == odd(bad="ab") == []
    assert odd(good="bc de", bad="af") == []
    assert odd(good="ab bc cd da", bad="ac") == []


def test_a_pair_that_fits_by_chance_with_fewer_matches_excuses_no_camera():
    pairs = {("a", "b"): JudgedPair(50, True), ("b", "c"): JudgedPair(50, True)}
    pairs |= {("a", "d"): JudgedPair(50, False), ("b", "d"): JudgedPair(60, False)}
    assert odd_cameras(pairs | {("c", "d"): JudgedPair(30, True)}) == ["d"]


def judged(**pairs):
    """Matches of pairs written as two letters, negative where they do not fit."""
    return {(a, b): JudgedPair(abs(n), n > 0) for (a, b), n in pairs.items()}


def test_one_pair_alone_accuses_only_with_many_matches_and_where_the_other_camera_fits():
    assert odd_cameras(judged(ab=-200, bc=50, ad=60, cd=50)) == []
    assert odd_cameras(judged(ab=1000, ac=-30)) == []
    assert odd_cameras(judged(ab=1000, ac=-150)) == ["c"]
    assert odd_cameras(judged(ab=91, ad=31, bd=64, cd=-105)) == ["c"]


def test_a_pair_of_few_matches_that_accuses_nobody_acquits_nobody():
    pairs = judged(ab=90, bc=90, ae=90, ad=-90, bd=-90, ef=-30)
    assert odd_cameras(pairs) == ["d"]
    assert odd_cameras(pairs | judged(ef=-150)) == ["d", "f"]
    assert odd_cameras(judged(ab=-50, bc=-50, ca=-50, de=50)) == []


def test_nobody_is_named_where_others_explain_as_much_whatever_their_names():
    pairs = {"ab": -100, "ac": -100, "bd": -100, "cd": -100, "ad": 100, "bc": 100, "ef": 100}
    assert odd_cameras(judged(**pairs)) == []
    few = judged(ac=-50, ad=-100, ae=100, bd=50)
    other = str.maketrans("abcde", "edcba")
    renamed = {(a.translate(other), b.translate(other)): one for (a, b), one in few.items()}
    back = [name.translate(other) for name in odd_cameras(renamed)]
    assert sorted(back) == odd_cameras(few)
