"""--mounting-force of a tared file: checked before the work, with the option named."""

import signal
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import biaxbayes
import quick_posteriors
from biaxbayes.errors import InputError, Interrupted
from biaxbayes.runs import checkpoint
from biaxbayes.runs.folder import manifest
from biaxbayes.specimens.specimen_file import parse_specimen, specimen_text, write_specimen
from biaxbayes.verbs.sample import Sampling
from commands import refused, run

FORCE = (0.0158, 0.0126)
TARED = biaxbayes.simulate(material="donor2-media", noise_N=0.0006)[0].zeroed()


@pytest.mark.parametrize(
    "force", [(15.8, 12.6), (15800.0, 12600.0), (1.6e-11, 1.3e-11)], ids=["mN", "uN", "GN"]
)
def test_a_wrong_unit_is_refused_before_a_folder_is_made(capsys, tmp_path, force):
    path, folder = tmp_path / "tared.csv", tmp_path / "run"
    write_specimen(TARED, path)
    err = refused(capsys, "sample", path, "--mounting-force", *force, "--out", folder)
    assert "tared.csv" in err and "--mounting-force" in err and "in N" in err and "row" not in err
    assert not folder.exists()


def prepared(specimen, force, folder: Path) -> Sampling:
    return Sampling.prepare(
        specimen,
        out=folder,
        options={"mounting": "noisy"},
        seed=1,
        ess=100.0,
        max_steps=200,
        workers=1,
        mounting_force=force,
    )


SIZES = st.floats() | st.floats(-1e6, 1e6) | st.floats(-0.05, 0.05)


@given(st.tuples(SIZES, SIZES), st.sampled_from([1e-3, 1.0, 20.0]))
@settings(max_examples=60, deadline=None)
def test_whatever_force_is_given_the_sampled_specimen_can_be_read_again(force, scale):
    """Or it is refused, naming the option, before anything is sampled."""
    specimen = biaxbayes.simulate(
        material="donor2-media", noise_N=0.0006, thickness=scale, increments=12
    )[0].zeroed()
    try:
        result = prepared(specimen, force, Path("unused")).specimen
    except InputError as error:
        assert "`mounting_force`" in str(error) or "stress" in str(error) or "load" in str(error)
        return
    lines = specimen_text(result).split("\n")
    assert parse_specimen(lines, Path("specimen.csv")).protocols == result.protocols


def test_a_sound_force_is_taken():
    result = prepared(TARED, FORCE, Path("unused")).specimen
    assert tuple(result.mounting_readings(shared=True)[0][0]) == pytest.approx(FORCE, abs=2e-3)


def test_the_corrected_command_goes_on_with_resume(capsys, tmp_path):
    """In a new folder, and in one that holds half a run: the wrong command has spoilt neither."""
    path, folder = tmp_path / "tared.csv", tmp_path / "run"
    write_specimen(quick_posteriors.small_specimen().zeroed(), path)
    options = ("--noise", "independent", "--mounting", "exact", "--fix", "kappa=0.1", "--ess", "60")
    arguments = ("sample", path, "--out", folder, *options, "--resume", "--mounting-force")
    right = quick_posteriors.small_specimen().mounting_readings(shared=True)[0][0]
    wrong = 1e3 * right  # in mN
    with quick_posteriors.runs_without_figures():
        assert run(capsys, *arguments, *wrong)[0] == 2
        with pytest.raises(Interrupted):
            biaxbayes.sample(
                path, out=folder, mounting_force=right, stop=lambda: signal.SIGINT,
                noise="independent", mounting="exact", priors={"kappa": 0.1}, ess=60.0,
            )  # fmt: skip
        before = manifest(folder)
        assert checkpoint.NAME in before
        assert run(capsys, *arguments, *wrong)[0] == 2
        assert manifest(folder) == before
        code, out, err = run(capsys, *arguments, *right)
    assert code in (0, 3) and "mounting_stretch_x" in out, err
    result = biaxbayes.open_run(folder).specimen
    assert tuple(result.mounting_readings(shared=True)[0][0]) == pytest.approx(right)
