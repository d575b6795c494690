"""Every hostile specimen file ends in its one-line message and exit code 2, or is read right."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from biaxbayes import read_specimen
from biaxbayes.cli import main
from biaxbayes.errors import InputError
from hostile.specimen_files import ACCEPTED, GOOD, HEADER, NAMES, REFUSED, content


def check(path: Path, capsys) -> tuple[int, str]:
    """Exit code and standard error of ``biaxbayes check``."""
    with pytest.raises(SystemExit) as stop:
        main(["check", "--no-fit", "--", str(path)])
    return int(stop.value.code or 0), capsys.readouterr().err


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: case.name)
def test_refused_with_its_message(case, tmp_path, capsys):
    path = case.make(tmp_path)
    with pytest.raises(InputError) as refusal:
        read_specimen(path)
    message = str(refusal.value)
    for fragment in (str(path), *case.says):
        assert fragment in message
    assert refusal.value.remedy
    code, err = check(path, capsys)
    assert code == 2
    assert err == f"biaxbayes: {message}\n"


@pytest.mark.parametrize("case", ACCEPTED, ids=lambda case: case.name)
def test_read_right(case, tmp_path, capsys):
    path = case.make(tmp_path)
    assert case.holds(read_specimen(path))
    code, err = check(path, capsys)
    assert code == 0
    assert "Traceback" not in err


def test_enough_hostile_files():
    assert len(REFUSED) >= 80
    assert len({case.name for case in (*REFUSED, *ACCEPTED)}) == len(REFUSED) + len(ACCEPTED)


def test_no_permission(tmp_path):
    path = content(GOOD)(tmp_path)
    path.chmod(0)
    nobody = os.geteuid() == 0
    if nobody:  # root reads everything
        os.seteuid(65534)
    try:
        with pytest.raises(InputError, match="may not be read; check its permissions"):
            read_specimen(path)
    finally:
        if nobody:
            os.seteuid(0)


def test_folder_without_permission_to_write(tmp_path):
    from biaxbayes import write_specimen

    specimen = read_specimen(content(GOOD)(tmp_path))
    with pytest.raises(InputError, match="is a folder"):
        write_specimen(specimen, tmp_path)
    with pytest.raises(InputError, match="nowhere does not exist; make it"):
        write_specimen(specimen, tmp_path / "nowhere" / "out.csv")


def test_messages_are_one_line_whatever_the_path(tmp_path, capsys):
    path = content(GOOD.replace("unloaded", "x"), "a\nb\x1b[31m.csv")(tmp_path)
    code, err = check(path, capsys)
    assert code == 2
    assert err.count("\n") == 1
    assert "\x1b" not in err


def test_file_name_that_is_not_text(tmp_path):
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff\xfe.csv"))
    path.write_text(GOOD.replace("# specimen: A12\n", ""))
    read_specimen(path).name.encode("utf-8")


@pytest.mark.slow
def test_a_million_rows_in_seconds(tmp_path):
    t = np.linspace(0.0, 1.0, 1_000_000)
    table = np.column_stack([1 + 0.2 * t, 1 + 0.1 * t, 0.1 + t, 0.1 + t * t])
    path = tmp_path / "long.csv"
    with path.open("w") as out:
        out.write(HEADER + NAMES)
        np.savetxt(out, table, delimiter=",", fmt="%.15f")
    program = (
        "import sys, resource, time, biaxbayes\n"
        "start = time.process_time()\n"
        "s = biaxbayes.read_specimen(sys.argv[1])\n"
        "assert s.protocols[0].rows == 1_000_000\n"
        "print(time.process_time() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=True
    )
    seconds, kilobytes = map(float, done.stdout.split())
    assert seconds < 5.0
    assert kilobytes < 1_000_000


def test_the_shell_sees_one_line(tmp_path):
    path = content(GOOD.replace("1.0500", "x"))(tmp_path)
    # from a small process: a forked one counts the memory of whoever forked it as its own
    program = (
        "import json, resource, subprocess, sys\n"
        "done = subprocess.run(sys.argv[1:], capture_output=True, text=True)\n"
        "used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss\n"
        "print(json.dumps([done.returncode, done.stdout, done.stderr, used]))\n"
    )
    command = [sys.executable, "-m", "biaxbayes.cli", "check", str(path)]
    done = subprocess.run(
        [sys.executable, "-c", program, *command], capture_output=True, text=True, check=True
    )
    code, out, err, kilobytes = json.loads(done.stdout)
    assert code == 2
    assert err.startswith("biaxbayes: ")
    assert err.count("\n") == 1
    assert out == ""
    assert kilobytes < 1_000_000
