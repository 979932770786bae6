"""Many may look at a panel; one has the controls."""

from stage.panel.access_control import Controls


def test_the_first_has_the_controls_until_somebody_takes_them():
    controls = Controls()
    assert controls.holder is None
    controls.come("a")
    controls.come("b")
    controls.come("b")
    assert (controls.holder, controls.watching) == ("a", 2)
    controls.take("b")
    assert controls.holder == "b"
    controls.take("stranger")
    assert controls.holder == "b"


def test_who_goes_leaves_the_controls_to_the_next():
    controls = Controls()
    for who in "abc":
        controls.come(who)
    controls.go("b")
    assert controls.holder == "a"
    controls.go("a")
    assert (controls.holder, controls.watching) == ("c", 1)
    controls.go("c")
    assert controls.holder is None
    controls.come("d")
    assert controls.holder == "d"


def test_who_loses_the_controls_lets_go_of_what_he_holds():
    controls, released = Controls(), []
    for who in "ab":
        controls.come(who)
        controls.when_lost(who, lambda who=who: released.append(who))
    controls.take("a")
    assert released == []
    controls.take("b")
    controls.take("b")
    assert released == ["a"]
    controls.go("a")
    assert released == ["a"]
    controls.go("b")
    assert released == ["a", "b"]
