"""Too few minutes are told once, for the stage that needs most."""

from dataclasses import replace

import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.reconstruct import loop
from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.step_plan import TimedPlan


def test_minutes_that_are_too_few_are_told_for_the_stage_that_needs_most(tmp_path, capsys):
    capture = read_capture(toy.write_capture(tmp_path / "capture", toy.scene()))
    options = replace(toy.SHORT, fit=replace(toy.SHORT.fit, minutes=0.5))
    log = RunLog(tmp_path / "run", resume=False, interval=1e9, writes=False, listener=None)
    session = Session(capture, log, options, False)

    def told(seconds, needed):
        plan = TimedPlan(seconds, 10)
        plan.seconds_of_fewest = needed
        capsys.readouterr()
        loop._say_changed(session, plan, 100)
        return capsys.readouterr().out

    # A quarter of the minutes for what stands still, and the rest.
    assert "fit.minutes=1.8 has time" in told(7.5, 27.0)
    assert told(22.5, 49.0) == ""
    assert "fit.minutes=2.3 has time" in told(22.5, 100.0)
