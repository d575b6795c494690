"""Records that cannot be a loading curve are named first and refused; sound ones never are."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import biaxbayes
import quick_posteriors
from biaxbayes.fitting.fit_quality import quick_fit, swapped_columns
from biaxbayes.options import SamplingPlan
from biaxbayes.specimens.check import check_specimen
from biaxbayes.specimens.specimen import Protocol, Specimen
from biaxbayes.specimens.specimen_file import read_specimen, write_specimen
from biaxbayes.verbs.sample import SampleJob
from commands import refused, run

DATA = Path(__file__).resolve().parents[1] / "data"
CURVES = ("stretch_x", "stretch_y", "load_x", "load_y")
RATIOS = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0))


def virtual(ratios=RATIOS, **how) -> Specimen:
    material = biaxbayes.GOH(14.0, 140.0, 11.9, 38.4, 0.1)
    usual = {"prestretch": (1.02, 1.02), "total_stretch": 1.15, "noise_N": 2e-3, "increments": 40}
    return biaxbayes.simulate(material=material, ratios=ratios, **{**usual, **how})[0]


GOOD = virtual()


def changed(specimen: Specimen, change) -> Specimen:
    """The specimen with each protocol's curves (n, 4) changed."""
    protocols = []
    for p in specimen.protocols:
        curves = change(np.column_stack([getattr(p, name) for name in CURVES]))
        protocols.append(Protocol(p.name, *curves.T))
    return replace(specimen, protocols=tuple(protocols))


def reversed_rows(curves):
    back = curves[::-1].copy()
    back[:, :2] /= back[0, :2]  # as the reader refers them to the first row
    return back


WRONG = {
    "cycles": (lambda c: np.vstack([c, c[::-1], c, c[::-1]]), "turns back"),
    "unloading after loading": (lambda c: np.vstack([c, c[::-1]]), "turns back"),
    "reversed": (reversed_rows, "are in reverse order"),
    "tension negative": (lambda c: c * [1, 1, -1, -1], "tension must be positive"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_a_loading_curve_is_refused_before_the_work(capsys, tmp_path, name):
    change, words = WRONG[name]
    path = tmp_path / "wrong.csv"
    write_specimen(changed(GOOD, change), path)
    err = refused(capsys, "sample", path, "--out", tmp_path / "run")
    assert f"{path}: cannot be a loading curve" in err and words in err and "--anyway" in err
    assert not (tmp_path / "run").exists()
    code, out, _ = run(capsys, "check", path, "--no-fit")
    kinds = ("error", "warning", "note")
    first = next(line for line in out.splitlines() if line.startswith(kinds))
    assert code == 2 and first.startswith("error: ")
    assert "refuses it without --anyway" in out and "no warnings" not in out
    more = sum(line.startswith("error: ") for line in out.splitlines()) - 1
    assert more > 0 and f"({more} more of the kind)" in err
    code, out, _ = run(capsys, "check", path, "--no-fit", "--json")
    assert code == 2 and any(f["severity"] == "error" for f in json.loads(out)["findings"])


def test_a_single_error_is_not_said_to_be_one_of_several(capsys, tmp_path):
    wrong, path = changed(GOOD, reversed_rows), tmp_path / "wrong.csv"
    write_specimen(replace(GOOD, protocols=(wrong.protocols[0], *GOOD.protocols[1:])), path)
    err = refused(capsys, "sample", path, "--out", tmp_path / "run")
    assert "are in reverse order" in err and "more of the kind" not in err


def test_anyway_samples_it_and_says_so_first(capsys, tmp_path):
    path = tmp_path / "cycles.csv"
    twice = changed(quick_posteriors.small_specimen(), WRONG["unloading after loading"][0])
    write_specimen(twice, path)
    with quick_posteriors.runs_without_figures():
        _, out, err = run(
            capsys, "sample", path, "--out", tmp_path / "run", "--anyway", "--ess", "60",
            "--mounting", "exact", "--noise", "independent", "--fix", "kappa=0.1",
        )  # fmt: skip
    assert "turns back" in err.splitlines()[0]
    assert "turns back" in out.splitlines()[1]
    opened = biaxbayes.open_run(tmp_path / "run")
    assert opened.provenance["findings"][0]["severity"] == "error"
    assert (
        "turns back" in (tmp_path / "run" / "report.html").read_text().split("Mounting stretch")[0]
    )


def test_columns_that_fit_as_they_are_are_not_exchanged():
    for specimen in (GOOD, sound(1), sound(2)):
        assert swapped_columns(specimen, quick_fit(specimen).residuals) is None
    other = changed(GOOD, lambda c: c[:, [0, 1, 3, 2]])
    assert swapped_columns(other, quick_fit(other).residuals).code == "swapped"


def errors_of(specimen: Specimen) -> list[str]:
    return [str(f) for f in check_specimen(specimen) if f.severity == "error"]


SOUND = (
    ((1.0, 1.0),),
    RATIOS,
    ((1.0, 0.0), (0.0, 1.0)),
    ((1.0, 0.3),),
    ((1.0, 1.0), (1.0, 0.75), (0.75, 1.0), (1.0, 0.5), (0.5, 1.0)),
)


def sound(seed: int) -> Specimen:
    """A specimen of any material, protocol, noise and misfit that a laboratory might have."""
    rng = np.random.default_rng([7, seed])
    material = biaxbayes.GOH(
        10.0 ** rng.uniform(0, 1.5),
        10.0 ** rng.uniform(0, 2.0),
        float(rng.choice([0.5, 2.0, 10.0, 50.0])),
        rng.uniform(0, 90),
        rng.uniform(0, 0.33),
    )
    how = {
        "material": material,
        "prestretch": tuple(rng.uniform(1.0, 1.05, 2)),
        "total_stretch": float(rng.choice([1.1, 1.15, 1.2])),
        "ratios": SOUND[seed % len(SOUND)],
        "increments": int(rng.choice([12, 50, 200])),
        "geometry": str(rng.choice(["unloaded", "mounted"])),
        "misfit": float(rng.choice([0.0, 0.01, 0.03])),
        "seed": seed,
    }
    peak = biaxbayes.simulate(**how)[0].peak_load
    noise = peak * float(rng.choice([0.0005, 0.002, 0.01, 0.03]))
    return biaxbayes.simulate(noise_N=noise, **how)[0]


@pytest.mark.parametrize("seed", range(20))
def test_sound_virtual_specimens_are_not_refused(seed):
    assert not errors_of(sound(seed))


SHIPPED = sorted([*DATA.glob("*.csv"), DATA / "examples" / "tared.csv"])


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_shipped_specimens_are_not_refused(path):
    assert not errors_of(read_specimen(path))


def test_one_protocol_cannot_carry_four_families():

    def findings(protocols: int, law: str) -> list[str]:
        made = replace(GOOD, protocols=GOOD.protocols[:protocols])
        options = {"law": law}
        amount = SamplingPlan(seed=0, ess=100.0, max_steps=128, workers=1)
        result = SampleJob.prepare(made, out="unused", options=options, amount=amount).findings
        return [str(f) for f in result]

    assert any(
        "with 1 protocol the posterior of the law four-fibre" in f
        for f in findings(1, "four-fibre")
    )
    assert not any("cannot carry" in f for f in findings(2, "four-fibre"))
    assert not any("cannot carry" in f for f in findings(1, "goh"))


def test_exchanged_force_columns_and_a_wrong_unit_are_named(tmp_path):
    """Both in one run: the columns exchanged, and MPa in the column for kPa."""
    wrong = changed(virtual(loads="piola"), lambda c: c[:, [0, 1, 3, 2]] * [1, 1, 1e-3, 1e-3])
    wrong = replace(wrong, load_noise=wrong.load_noise * 1e-3)
    notes = []
    with quick_posteriors.runs_without_figures():
        opened = biaxbayes.sample(
            wrong,
            out=tmp_path / "run",
            progress=lambda p: notes.append(p.note),
            **quick_posteriors.QUICK,
        )
    output = [n for n in notes if n]
    assert "is the file in MPa" in output[0]
    assert any("seem to be swapped" in n for n in output)
    assert {f["code"] for f in opened.provenance["findings"]} == {"units", "swapped"}
