"""The command line, called in this process."""

import pytest

from biaxbayes.cli import main


def exit_code(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    return int(ended.value.code or 0)


def run(capsys, *arguments: object) -> tuple[int, str, str]:
    """Exit code, standard output and standard error."""
    capsys.readouterr()
    code = exit_code(*arguments)
    out, err = capsys.readouterr()
    assert "Traceback" not in err and "internal error" not in err
    return code, out, err


def refused(capsys, *arguments: object) -> str:
    """The one line of a refusal."""
    code, out, err = run(capsys, *arguments)
    assert code == 2 and out == "", (code, out)
    assert err.count("\n") == 1 and err.rstrip("\n").isprintable() and len(err) < 800, err
    return err
