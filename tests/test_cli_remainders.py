"""Commands: what is drawn after Ctrl-C, completion of each shell, pictures that replace nothing unasked."""

from types import SimpleNamespace

import pytest

from stage import Stage
from stage.cli import erratum_plot, main, output_files
from stage.cli.erratum import ErratumResult
from stage.cli.fault import demonstration_plot
from stage.cli.fault.demonstrations import DEMOS, DemoResult
from stage.cli.output_and_progress import ClosableOutput


@pytest.mark.parametrize(
    ("block", "drawn"),
    [(lambda *a: output_files.record_for_plot(*a, interval=1e-3), 0), (output_files.record_to_files, 1)],
    ids=["for_plot", "to_files"],
)
def test_after_ctrl_c_only_a_command_that_draws_its_reports_does(block, drawn, tmp_path, capsys):
    drawings = []

    class Report:
        def plot(self, path, overwrite):
            drawings.append(path)

    stop = KeyboardInterrupt()
    stop.reports = [Report()]
    none = dict.fromkeys(("record", "vcd", "picture", "trace"))
    args = SimpleNamespace(
        **none, view=False, web=False, json=False, force=False, plot=str(tmp_path / "a.png"), written_files=[]
    )
    with pytest.raises(KeyboardInterrupt), block(args, Stage("xy", visuals=False)):
        raise stop
    assert len(drawings) == drawn
    assert "interrupted after 0.00 s" in capsys.readouterr().out


def test_completion_scripts_differ_by_shell(capsys):
    pytest.importorskip("argcomplete")
    scripts = []
    for shell in ("bash", "zsh", "fish"):
        assert main(["completion", shell]) == 0
        scripts.append(capsys.readouterr().out)
    assert "complete --command stage" in scripts[2] or "complete -c stage" in scripts[2]
    assert scripts[2] not in scripts[:2]


@pytest.mark.parametrize("overwrite", [None, True])
def test_a_plot_of_two_runs_overwrites_a_file_only_on_request(overwrite, monkeypatch):
    calls = []
    for module, name in ((erratum_plot, "draw_erratum_plot"), (demonstration_plot, "draw_demonstration")):
        monkeypatch.setattr(module, name, lambda result, path, over: calls.append((path, over)))
    for result in (
        ErratumResult("MCX304", False, ({}, {}), (None, None)),
        DemoResult("jam", DEMOS["jam"], ({}, {}), (None, None)),
    ):
        result.plot("a.png") if overwrite is None else result.plot("a.png", overwrite)
        result.plot()
    assert calls == [("a.png", bool(overwrite)), (None, False)] * 2


def test_output_is_flushed_on_request_and_at_the_end():
    class Stream:
        done = 0

        def write(self, text):
            return len(text)

        def flush(self):
            self.done += 1

    stream = Stream()
    out = ClosableOutput(stream)
    print("a", file=out, flush=True)
    assert (stream.done, out.error) == (1, None)
