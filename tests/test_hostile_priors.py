"""Every hostile priors file ends in its one-line message and exit code 2, or is read right."""

from __future__ import annotations

from pathlib import Path

import pytest

from biaxbayes.cli import main
from biaxbayes.model.priors import read_priors
from hostile.priors_files import ACCEPTED, REFUSED
from hostile.specimen_files import GOOD


@pytest.mark.parametrize("name", REFUSED)
def test_refused_with_its_message(name, tmp_path, capsys):
    content, says = REFUSED[name]
    path, specimen = tmp_path / "priors.toml", tmp_path / "specimen.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    specimen.write_text(GOOD)
    with pytest.raises(SystemExit) as ended:
        main(["sample", str(specimen), "--priors", str(path), "--out", str(tmp_path / "run")])
    err = capsys.readouterr().err
    assert ended.value.code == 2
    assert err.count("\n") == 1 and err.rstrip("\n").isprintable()
    assert err.startswith(f"biaxbayes: {path}") and len(err) < 600
    for fragment in says:
        assert fragment in err
    assert not (tmp_path / "run").exists()
    assert not Path("owned").exists() and not (tmp_path / "owned").exists()


def test_read_right(tmp_path):
    read = {}
    for name, content in ACCEPTED.items():
        path = tmp_path / "ä priors.toml"
        path.write_bytes(content)
        read[name] = read_priors(path)
    assert read["bom"] == read["comments"] == {"kappa": 0.1}
    assert read["crlf"]["kappa"] == 0.1
    assert (read["crlf"]["k1"].factor, read["crlf"]["k1"].other) == (2.0, "C1")
    assert read["exponent"] == {"C1": 10.0, "k2": 0.0}
    assert read["table"]["alpha"].as_table() | {"low": 0, "high": 0} == {
        "distribution": "normal", "mean": 41.0, "sd": 5.0, "low": 0, "high": 0,
    }  # fmt: skip
    dotted = read["dotted"]["alpha"].as_table()
    assert (dotted["low"], dotted["high"]) == (10.0, 90.0)  # cut where alpha ends
