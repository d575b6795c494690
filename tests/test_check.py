"""What ``check`` says of a specimen: each warning where it belongs, and none where it does not."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from biaxbayes import GOH, Protocol, Specimen, check, write_specimen
from biaxbayes.fitting.fit_quality import misfit_finding, quick_fit
from biaxbayes.machines.cycles import cut
from biaxbayes.mechanics.virtual_test import virtual_test
from biaxbayes.specimens.branches import path_progress, reversal
from biaxbayes.specimens.check import check_specimen
from commands import refused, run

# A test of the paper's donor 2 media (Table 6, fip).
MEDIA = GOH(C1_kPa=14.0, k1_kPa=140.0, k2=11.9, alpha_deg=38.4, kappa=0.21)


def protocol(
    name="1", ratio=(1.0, 1.0), *, noise=0.05, prestretch=(1.02, 1.03), seed=0
) -> Protocol:
    """A virtual test recorded as first Piola-Kirchhoff stress with a noisy load cell."""
    test = virtual_test(
        MEDIA, mounting_stretch=prestretch, measured_stretch=1.18, ratio=ratio, increments=100
    )
    load = test.piola_kPa
    load += np.random.default_rng(seed).normal(0.0, noise, load.shape)
    return Protocol(name, *test.measured.T, *load.T)


def specimen(*protocols: Protocol, **others) -> Specimen:
    return Specimen("virtual", protocols, "piola", load_noise=0.05, **others)


def codes(subject: Specimen) -> set[str]:
    return {finding.code for finding in check_specimen(subject)}


GOOD = specimen(protocol("1:1", seed=1), protocol("1:0.5", (1.0, 0.5), seed=2))


P, Q = GOOD.protocols
THERE_AND_BACK = np.r_[np.arange(101), np.arange(100, 40, -1)]
JUMP = np.where(np.arange(101) == 50, 0.3 * np.ptp(Q.load_x), 0.0)
OTHER = protocol("1:0.5", (1.0, 0.5), seed=2, prestretch=(1.02, 1.04))
FINDINGS = {  # a specimen with one fault, and what names it
    "tared": ((replace(Q, load_x=Q.load_x - Q.load_x[0]),), "in x"),
    "negative-mounting-force": ((replace(P, load_x=P.load_x - P.load_x[0] - 0.5),), "in x"),
    "mounting-force-in-noise": (
        (replace(P, load_y=P.load_y - P.load_y[0] + 0.04),),
        "0.04 +- 0.05",
    ),
    "mounting-forces-differ": ((P, OTHER), "per-protocol"),
    "unloading": (
        (Protocol("1", *Q.stretch[THERE_AND_BACK].T, *Q.recorded_load[THERE_AND_BACK].T),),
        "row 101 of 161",
    ),
    "jump": ((replace(Q, load_x=Q.load_x + JUMP),), "row 51 of 101"),
}


@pytest.mark.parametrize("code", FINDINGS)
def test_a_fault_is_the_one_finding(code):
    protocols, words = FINDINGS[code]
    findings = [f for f in check_specimen(specimen(*protocols)) if f.severity != "note"]
    assert [f.code for f in findings] == [code] and words in findings[0].message


CUT = [*Q.load_y[:-1], float(str(Q.load_y[-1])[:1])]  # its last number
EVEN = np.linspace(0.0, 1.0, 60)
RESAMPLED = Protocol("1", 1 + 0.2 * EVEN**0.5, 1 + 0.1 * EVEN**0.5, 1 + 49 * EVEN, 1 + 24 * EVEN)


@pytest.mark.parametrize(
    ("code", "subject", "words"),
    [
        ("jump", specimen(replace(Q, load_y=CUT)), "row 101 of 101"),
        ("noise-differs", Specimen("a", (P,), "piola", load_noise=1.0), ""),
        ("resampled", specimen(RESAMPLED), ""),
    ],
)
def test_a_fault_is_among_the_findings(code, subject, words):
    (finding,) = (f for f in check_specimen(subject) if f.code == code)
    assert words in finding.message


def test_a_clean_specimen_has_no_findings_and_a_tared_one_no_weak_force():
    assert check_specimen(GOOD) == () and "no-noise" not in codes(specimen(protocol(noise=0.0)))
    assert "tared" in codes(GOOD.zeroed())
    assert "mounting-force-in-noise" not in codes(GOOD.zeroed())


def test_units():
    p = GOOD.protocols[0]
    for pair, factor, words in (
        ("piola", 1e3, "in Pa?"),
        ("piola", 1e-3, "in MPa?"),
        ("force", 102.0, "in gf or mN?"),
        ("force", 1e-3, "in kgf or kN?"),
    ):
        scaled = replace(p, load_x=p.load_x * factor, load_y=p.load_y * factor)
        # loads in kPa are forces in N on a section of 1000 mm2
        given = {"edge_x_mm": 1e3, "edge_y_mm": 1e3, "thickness_mm": 1.0} if pair == "force" else {}
        units = Specimen("a", (scaled,), pair, metadata={"stress_limit_kPa": 1e6}, **given)
        messages = [f.message for f in check_specimen(units)]
        assert any(f"is the file {words}" in message for message in messages)
    one = replace(p, load_x=p.load_x * 1000.0)
    assert any(
        "same unit" in f.message
        for f in check_specimen(specimen(one, metadata={"stress_limit_kPa": 1e6}))
    )
    thick = specimen(p, edge_x_mm=20.0, edge_y_mm=20.0, thickness_mm=900.0)
    messages = [f.message for f in check_specimen(thick)]
    for words in ("thickness_mm of 900 is unusual", "900 mm thick and only 20 mm wide"):
        assert sum(words in message for message in messages) == 1


def test_stiff_start_is_more_than_a_soft_matrix_does():
    # A neo-Hookean matrix is concave by itself: no warning.
    soft = GOH(C1_kPa=30.0, k1_kPa=0.0, k2=1.0, alpha_deg=0.0, kappa=0.0)
    test = virtual_test(
        soft, mounting_stretch=(1.01, 1.01), measured_stretch=(1.3, 1.2), increments=400
    )
    rng = np.random.default_rng(0)
    load = test.piola_kPa + rng.normal(0, 0.05, (401, 2))
    p = Protocol("1", *test.measured.T, *load.T)
    assert "stiff-start" not in codes(specimen(p))
    # The same with a friction-like rise in the first per cents of the path.
    rise = 12.0 * (1.0 - np.exp(-(p.stretch_x - 1.0) / 0.01))
    assert "stiff-start" in codes(specimen(replace(p, load_x=p.load_x + rise)))


def test_a_record_that_only_rises_keeps_every_row():
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 1.0, 300)
    stretch = 1.0 + np.column_stack([-0.01 * t * (1 - t) + 0.02 * t**2, 0.2 * np.sqrt(t)])
    stretch += rng.normal(0.0, 1e-4, stretch.shape)
    load = 50.0 * np.column_stack([t, t]) + rng.normal(0.0, 0.2, (300, 2))
    path = path_progress(stretch, load)
    assert reversal(path) is None
    (cycle,) = cut(path)
    assert cycle.loading[0] == 0 and cycle.loading[-1] > 290


def test_goh_describes_its_own_specimen_and_not_another_law():
    result = misfit_finding(GOOD, quick_fit(GOOD))
    assert result.severity == "note" and result.message.startswith("GOH misses this record by ")
    # Two directions that know nothing of each other: no GOH material does that.
    t = np.linspace(0.0, 1.0, 60)
    odd = []
    for a, b in ((1.0, 1.0), (1.0, 0.3), (0.3, 1.0)):
        load = 1 + 80 * t**6, 1 + 60 * t ** (1 + 5 * b)
        odd.append(Protocol(f"{a}:{b}", 1 + 0.3 * a * t, 1 + 0.6 * b * t, *load))
    result = misfit_finding(specimen(*odd), quick_fit(specimen(*odd)))
    assert result.severity == "warning"


def test_check_and_a_run_say_the_same_of_a_misfit(media_run):
    """Both name the miss of the best fit, not of the median of the draws."""
    said = misfit_finding(media_run.specimen, quick_fit(media_run.specimen)).message
    assert media_run.result.fit == said.partition(";")[0]


def test_the_text_holds_what_was_understood(tmp_path, capsys):
    size = {"edge_x_mm": 20.0, "edge_y_mm": 18.0, "thickness_mm": 1.35}
    write_specimen(specimen(*GOOD.protocols, layer="media", **size), tmp_path / "a.csv")
    code, out, err = run(capsys, "check", str(tmp_path / "a.csv"))
    assert (code, err) == (0, "")
    for words in ("20 × 18 mm, 1.35 mm", "1:0.5", "202 rows in 2 protocols", "0.047 kPa"):
        assert words in out
    assert max(map(len, out.splitlines())) <= 100


def test_json_is_the_same_as_data(tmp_path, capsys):
    write_specimen(GOOD.zeroed(), tmp_path / "a.csv")
    code, out, _ = run(capsys, "check", str(tmp_path / "a.csv"), "--json", "--no-fit")
    assert code == 0  # a warning, no error
    record = json.loads(out)
    assert record["tared"] is True
    assert [f["code"] for f in record["findings"]] == ["tared", "grips", "alignment"]
    assert [p["rows"] for p in record["protocols"]] == [101, 101]
    assert record["protocols"][0]["mounting_force_x"] == 0.0


def test_figure(tmp_path, capsys):
    odd = [replace(p, name=f"$x^{i}$ <b> µ {p.name}") for i, p in enumerate(GOOD.protocols)]
    write_specimen(specimen(*odd, axis_x="umlaufend $"), tmp_path / "a.csv")
    words = ("check", tmp_path / "a.csv", "--no-fit", "--figure")
    for ending, head in (("png", b"\x89PNG"), ("pdf", b"%PDF-"), ("svg", b"<?xml")):
        path = tmp_path / f"b.{ending}"
        assert run(capsys, *words, path)[0] == 0 and path.read_bytes().startswith(head)
    assert "'.doc'" in refused(capsys, *words, "b.doc") and not Path("b.doc").exists()


def test_axes_that_no_record_without_shear_can_show_are_said_to_be_assumed():
    """Once, and not where tracked points give the shear, which is a finding beyond 3 degrees."""
    subject = specimen(protocol())
    (note,) = (f for f in check(subject, fit=False).findings if f.code == "alignment")
    assert note.severity == "note" and "k1 1.2 (1.8) times" in note.message
    for angle, severity in ((2.9, "note"), (3.1, "warning")):
        known = {"largest_shear": 0.01, "largest_shear_angle_deg": angle}
        turned = replace(subject, metadata=subject.metadata | known)
        found = {f.code: f for f in check(turned, fit=False).findings}
        assert "alignment" not in found and found["shear"].severity == severity
