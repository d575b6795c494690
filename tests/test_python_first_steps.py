"""What somebody types first in Python: paths, keywords, one readable line each, progress."""

import io
import sys
import time
import types

import numpy as np
import pytest

import biaxbayes
from biaxbayes.errors import InputError
from biaxbayes.progress_bar import Progress, minute_lines, with_progress
from biaxbayes.specimens.specimen_file import write_specimen

MADE = biaxbayes.simulate(material="donor2-media", noise_N=0.0006, increments=30)[0]


@pytest.fixture
def path(tmp_path):
    write_specimen(MADE, tmp_path / "media.csv")
    return tmp_path / "media.csv"


def test_verbs_take_a_path_as_sample_does(path):
    assert biaxbayes.check_specimen(path) == biaxbayes.check_specimen(MADE)
    assert biaxbayes.fit(str(path), "zeroed").record() == biaxbayes.fit(MADE, "zeroed").record()


def test_fit_all(path):
    found = biaxbayes.fit(path, "all", starts=2)
    assert [f.method for f in found] == ["standard", "zeroed", "fip", "linden", "constrained"]


def test_convert_by_keywords(tmp_path):
    raw = tmp_path / "raw.csv"
    steps = np.linspace(0.0, 0.2, 21)
    rows = [f"{1 + t},{1 + t / 2},{1 + 50 * t},{1 + 30 * t}" for t in steps]
    raw.write_text("a,b,P_kPa,Q_kPa\n" + "\n".join(rows))
    columns = "stretch_x=a:stretch,stretch_y=b:stretch,piola_x_kPa=P_kPa,piola_y_kPa=Q_kPa"
    found = biaxbayes.convert(raw, machine="generic", columns=columns, out=tmp_path / "made.csv")
    same = biaxbayes.convert([raw], biaxbayes.Choice("generic", columns=(columns,)))
    assert found.specimen.protocols == same.specimen.protocols
    assert "made.csv" not in repr(found) and "raw.csv" in repr(found)
    for wrong, message in (({}, "no machine"), ({"machine": "generic", "sheet": "A"}, "sheets")):
        with pytest.raises(InputError, match=message):
            biaxbayes.convert(raw, **wrong)


def test_objects_print_as_one_readable_line(path, small_run):
    shown = [
        repr(MADE),
        repr(MADE.protocols[0]),
        repr(biaxbayes.fit(path, "zeroed")),
        repr(biaxbayes.check(path, fit=False)),
        repr(small_run),
        repr(biaxbayes.identify(small_run)),
    ]
    for line in shown:
        assert "\n" not in line and len(line) < 320 and "array(" not in line, line
    assert shown[0] == "Specimen('donor2-media', media, 1 protocol, 31 rows of force)" or (
        "1 protocol, 31 rows of force" in shown[0]
    )
    assert small_run.state in shown[4]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Replaced:
    """A notebook's display: one output, whose text is replaced."""

    def __init__(self):
        self.texts = []

    def display(self, data, *, raw, display_id):
        assert raw and display_id
        self.update(data, raw=raw)
        return self

    def update(self, data, *, raw):
        self.texts.append(data["text/plain"])


@with_progress
def verb(*, progress=None) -> bool:
    if progress is not None:
        progress(Progress("sampling", 0.5, note="half of it"))
    return progress is not None


def test_long_calls_show_their_progress_where_somebody_watches(monkeypatch):
    assert not verb() and not verb(progress=False)
    output = []
    assert verb(progress=output.append) and output[0].phase == "sampling"
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert verb() and "half of it" in sys.stderr.getvalue()
    assert not verb(progress=False)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)  # no ipywidgets
    lines, shell = Replaced(), types.SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "IPython.display", lines)
    assert verb()
    assert lines.texts == ["starting", "sampling 50 %", ""]
    for name in ("sample", "batch", "compare", "ledger", "design", "calibrate"):
        assert getattr(biaxbayes, name).__wrapped__, name


def test_a_terminal_without_a_live_line_gets_a_line_each_minute(capsys):
    with minute_lines() as show:
        show(Progress("sampling"))
    assert capsys.readouterr().err == ""  # less than a minute
    err = ""
    with minute_lines(every=0.01) as show:
        show(Progress("sampling", 1 / 9, note="sampled again"))
        # nothing is reported any more, and the line is repeated all the same
        deadline = time.monotonic() + 20.0
        while err.count("sampling") < 2 and time.monotonic() < deadline:
            time.sleep(0.01)
            err += capsys.readouterr().err
    assert err.count("sampled again") == 1 and err.count("sampling, 11 %") > 1
