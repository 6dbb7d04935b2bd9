"""What `gaussray prepare` prints: what is doubtful, and what to do about it."""

import signal

import pytest

from gaussray.cli.main import main


FACTS = {"cameras": {"a": {}, "b": {}}, "timestamps": 3, "rate": 10.0, "points": 90}
DOUBT = {"level": "warn", "subject": "exposure", "text": "b differs", "remedy": "Lock it."}
GOOD = {"level": "good", "subject": "points", "text": "90 points", "remedy": ""}


@pytest.mark.parametrize("report", [True, False])
@pytest.mark.parametrize("findings", [[GOOD, DOUBT], [GOOD]])
def test_remedies_are_printed_and_a_report_is_named_only_if_there_is_one(
    tmp_path, monkeypatch, capsys, report, findings
):
    facts = FACTS | {"findings": findings}
    monkeypatch.setattr("gaussray.prepare.prepare_capture", lambda *_, **__: facts)
    monkeypatch.setattr("gaussray.report.write_page", lambda *_, **__: tmp_path / "report.html")
    (tmp_path / "in").mkdir()
    main(["prepare", f"videos={tmp_path}/in", f"out={tmp_path}/out", f"report={report}"])
    said = capsys.readouterr()
    said = said.out + said.err
    assert f"{tmp_path}/out: 2 cameras, 3 timestamps, 90 points.\n" in said
    assert f"Next: gaussray reconstruct capture.path={tmp_path}/out" in said
    doubtful = len(findings) > 1
    assert ("1 doubtful:\n- exposure: b differs. Lock it.\n" in said) == doubtful
    assert (f"See {tmp_path}/out/report.html." in said) == (doubtful and report)


@pytest.fixture
def interruptible():
    """Programs that a shell begins in the background ignore SIGINT."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_says_that_the_command_starts_anew(tmp_path, monkeypatch, capsys, number):
    """SIGTERM ends it as Ctrl-C does: what is in the middle of its work cleans up."""
    cleaned = []

    def prepare(*_, **__):
        try:
            signal.raise_signal(number)
        finally:
            if number == signal.SIGTERM:
                # A second one does not end what is cleaning up.
                signal.raise_signal(number)
            cleaned.append(True)

    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr("gaussray.prepare.prepare_capture", prepare)
    (tmp_path / "in").mkdir()
    with pytest.raises(SystemExit) as ended:
        main(["prepare", f"videos={tmp_path}/in", f"out={tmp_path}/out"])
    assert ended.value.code == 130 and cleaned
    assert "gaussray: interrupted. The same command starts anew." in capsys.readouterr().err
    assert signal.getsignal(signal.SIGTERM) is before
