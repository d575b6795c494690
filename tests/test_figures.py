"""Figures, measured: what is drawn where, at which size, and that no two texts meet."""

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.contour import QuadContourSet
from matplotlib.path import Path
from scipy.integrate import trapezoid
from scipy.stats import norm

from biaxbayes.errors import InputError
from biaxbayes.figures.bands import bands_figure
from biaxbayes.figures.corner import corner_figure
from biaxbayes.figures.mounting import mounting_figure
from biaxbayes.figures.prediction import inflation_figure
from biaxbayes.figures.style import figure_bytes, print_style, read_style, save_figure
from biaxbayes.figures.trace import trace_figure
from biaxbayes.laws.published import MATERIALS
from biaxbayes.model.posterior import Posterior
from biaxbayes.parameters import PieceLabels, Quantities
from biaxbayes.prediction.bands import bands
from biaxbayes.prediction.percentiles import BANDS
from biaxbayes.prediction.stress import BEYOND, INSIDE
from biaxbayes.report_table import interval_texts
from biaxbayes.specimens.specimen import Protocol, Specimen
from biaxbayes.specimens.truth import read_truth
from biaxbayes.specimens.virtual_specimen import Machine, virtual_specimen
from goh_functions import GOH_LAW
from readable import assert_readable, in_view

HOSTILE = "a$b^2$ 100% <b>_x_ \\frac{ \n\t 中文 é " + "very long " * 30
MOUNTING = {"mounting_stretch_x": 1.009, "mounting_stretch_y": 1.010}
RATIOS = ((1.0, 1.0), (1.0, 0.75), (1.0, 0.5), (0.75, 1.0), (0.5, 1.0))


def specimen_of(ratios=RATIOS[:1], increments=40, **kw) -> Specimen:
    return virtual_specimen(
        MATERIALS["donor2-media"].material, name="media", mounting_stretch=(1.009, 1.010),
        measured_stretch=1.2, ratios=ratios, increments=increments,
        machine=Machine(noise_N=0.0006), seed=1, **kw,
    )[0]  # fmt: skip


def draws_of(n=4000, seed=3, states=("",), **columns) -> pd.DataFrame:
    """Draws about the media of Table 6: correlated, kappa against its limit."""
    rng = np.random.default_rng(seed)
    z = rng.standard_normal((n, 5))
    table = {
        "C1": 2.98 * np.exp(0.3 * z[:, 0]),
        "k1": 12.47 * np.exp(0.3 * (0.9 * z[:, 0] + 0.44 * z[:, 1])),
        "k2": 1.88 * np.exp(0.2 * z[:, 2]),
        "alpha": 39.0 - 2.0 * np.abs(z[:, 3]),
        "kappa": 0.08 * np.abs(z[:, 4]),
    }
    for state in states:
        tail = f"[{state}]" if state else ""
        for axis, lm, f in (("x", 1.009, 0.0148), ("y", 1.010, 0.0135)):
            table[f"mounting_stretch_{axis}{tail}"] = lm + 0.003 * rng.standard_normal(n)
            table[f"mounting_force_{axis}{tail}"] = f + 0.0006 * rng.standard_normal(n)
    table["noise_sd"] = 0.001 * np.exp(0.1 * rng.standard_normal(n))
    return pd.DataFrame(table | {k: np.broadcast_to(v, n) for k, v in columns.items()})


def exact(specimen: Specimen, **options) -> Posterior:
    """The law is the tissue; errors are independent."""
    return Posterior(specimen, noise="independent", **options)


# --- corner ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("width", "case"),
    [(85.0, "usual"), (180.0, "limits"), (85.0, "decades"), (180.0, "decades"), (85.0, "tight")],
)
def test_corner_is_readable(width, case):
    rng = np.random.default_rng(0)
    n = 3000
    columns = {
        "usual": {},
        "limits": {"kappa": rng.exponential(0.01, n), "alpha": 90.0 - rng.exponential(1.0, n)},
        "decades": {
            "k2": 10.0 ** rng.uniform(-3.0, 2.0, n),
            "C1": 10.0 ** rng.uniform(-1.0, 5.0, n),
            "kappa": rng.uniform(0.0, 1.0 / 3.0, n),
            "alpha": rng.uniform(0.0, 90.0, n),
        },
        "tight": {"mounting_stretch_x": 1.0 + 1e-5 * rng.standard_normal(n)},
    }[case]
    draws = draws_of(n, **columns)
    truth = {"C1": 2.98, "k1": 12.47, "kappa": 0.0, "alpha": 90.0}
    assert_readable(corner_figure(draws, truth=truth, width_mm=width), width)


def panel(figure, i, j):
    return figure.axes[i * (i + 1) // 2 + j]


def test_density_stays_up_at_a_physical_limit():
    # Half-normal draws against kappa = 0: the density is highest there. A plain kernel estimate
    # loses half of it past the limit.
    rng = np.random.default_rng(2)
    draws = draws_of(20_000, kappa=0.05 * np.abs(rng.standard_normal(20_000)))
    ax = panel(corner_figure(draws), 4, 4)
    assert ax.get_xlim()[0] == 0.0
    x, y = max((line.get_xydata().T for line in ax.lines), key=lambda xy: xy.shape[1])
    y = y / trapezoid(y, x)
    assert x[0] == 0.0
    for z in (0.0, 1.0, 2.0):
        wanted = 2.0 * norm.pdf(z) / 0.05
        assert np.interp(0.05 * z, x, y) == pytest.approx(wanted, rel=0.06), z


def inside(ax, content, points):
    """Which points lie in the shades of a panel that hold a share of the draws."""
    (drawn,) = [c for c in ax.collections if isinstance(c, QuadContourSet) and c.filled]
    # Beyond 99 %, 99 to 90 %, 90 to 50 %, within 50 %. A shade has a hole where the next one lies.
    shades = drawn.get_paths()[{0.99: 1, 0.9: 2, 0.5: 3}[content] :]
    crossings = [
        sum(Path(polygon).contains_points(points).astype(int) for polygon in shade.to_polygons())
        for shade in shades
    ]
    return (np.array(crossings) % 2 == 1).any(axis=0)


def test_regions_reach_the_limit_and_hold_their_share():
    # Independent quantities, kappa half-normal: the 90 % region touches kappa = 0.
    rng = np.random.default_rng(5)
    n = 20_000
    kappa, C1 = 0.05 * np.abs(rng.standard_normal(n)), 10.0 + rng.standard_normal(n)
    ax = panel(corner_figure(pd.DataFrame({"C1": C1, "kappa": kappa})), 1, 0)
    assert ax.get_ylim()[0] == 0.0
    for content in (0.5, 0.9, 0.99):
        share = inside(ax, content, np.column_stack([C1, kappa])).mean()
        assert share == pytest.approx(content, abs=0.02)
    # (C1 - 10, kappa / 0.05) reflected is a standard normal: the region ends at radius 2.146
    x = np.linspace(5.0, 15.0, 2001)
    ends = x[inside(ax, 0.9, np.column_stack([x, np.full_like(x, 1e-6)]))]
    assert ends.max() == pytest.approx(12.146, abs=0.2)
    assert ends.min() == pytest.approx(7.854, abs=0.2)


def test_narrow_ridge_stays_narrow():
    rng = np.random.default_rng(6)
    a = 100.0 + rng.standard_normal(20_000)
    b = a + 0.05 * rng.standard_normal(20_000)
    ax = panel(corner_figure(pd.DataFrame({"C1": a, "k1": b})), 1, 0)
    (low, high), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    x, y = np.meshgrid(np.linspace(low, high, 700), np.linspace(bottom, top, 700))
    share = inside(ax, 0.9, np.column_stack([x.ravel(), y.ravel()])).mean()
    area = share * (high - low) * (top - bottom)
    # Area of the 90 % ellipse: pi * 4.605 * sqrt(det covariance)
    assert 0.9 * np.pi * 4.605 * 0.05 < area < 1.9 * np.pi * 4.605 * 0.05


def test_the_interval_of_a_panel_is_that_of_the_table_at_a_limit_too():
    """Central, with the digits of report.csv, though kappa lies against its end."""
    rng = np.random.default_rng(1)
    draws = draws_of(10_000, kappa=rng.exponential(0.02, 10_000))
    written = [text for text, _ in in_view(corner_figure(draws, width_mm=180.0))]
    for name, start in (("kappa", r"$\kappa$"), ("k1", "$k_1$ (kPa)"), ("alpha", r"$\alpha$ (°)")):
        low, median, high = np.quantile(draws[name], [0.05, 0.5, 0.95])
        texts = interval_texts(median, low, high, GOH_LAW.parameter(name))
        (found,) = [text for text in written if text.startswith(f"{start}  ")]
        assert found.endswith(f"  {texts[0]} ({texts[1]}–{texts[2]})")


# --- bands ----------------------------------------------------------------------------------


def test_bands_of_certain_draws_are_the_model_and_its_noise():
    # All draws equal: the credible band has no width, the predictive one is a normal.
    specimen = specimen_of()
    media = MATERIALS["donor2-media"].material
    values = dict(zip(GOH_LAW.names, media.values, strict=True)) | MOUNTING | {"noise_sd": 0.002}
    sure = pd.DataFrame([values] * 8)
    table = bands(exact(specimen), sure)
    for axis, direction in enumerate("xy"):
        part = table[table["direction"] == direction]
        p = specimen.protocols[0]
        model = media.piola(p.stretch_x * 1.009, p.stretch_y * 1.010)[axis] * specimen.area[axis]
        for level in (5, 50, 95):
            np.testing.assert_allclose(part[f"credible_q{level:02d}"], model, rtol=1e-12)
            wanted = model + 0.002 * norm.ppf(level / 100.0)
            np.testing.assert_allclose(part[f"predictive_q{level:02d}"], wanted, rtol=1e-7)
        np.testing.assert_array_equal(part["measured"], specimen.load(p)[:, axis])


def test_zeroing_and_stress_pairs_in_bands():
    specimen, draws = specimen_of(), draws_of(50)
    ignored = draws.drop(columns=[c for c in draws if c.startswith("mounting")])
    zeroed = bands(exact(specimen, mounting="zeroed"), ignored)
    first = zeroed[zeroed["row"] == 0]
    np.testing.assert_allclose(first["measured"], 0.0, atol=1e-15)
    np.testing.assert_allclose(first["credible_q50"], 0.0, atol=1e-12)
    # A Cauchy file: nominal stress times measured stretch
    (p,) = specimen.protocols
    in_kPa = (replace(p, load_x=p.load_x * 1e3, load_y=p.load_y * 1e3),)
    a, b = (
        bands(exact(replace(specimen, loads=pair, protocols=in_kPa)), draws)
        for pair in ("cauchy", "piola")
    )
    np.testing.assert_allclose(a["measured"], b["measured"])
    np.testing.assert_allclose(a["credible_q95"], b["credible_q95"] * b["stretch"])


@pytest.mark.parametrize("width", [85.0, 180.0])
@pytest.mark.parametrize("ratios", [RATIOS[:1], RATIOS])
def test_bands_figure_is_readable(width, ratios):
    specimen = specimen_of(ratios, labels={"axis_x": "circumferential", "axis_y": "axial"})
    figure = bands_figure(exact(specimen), draws_of(300), width_mm=width)
    assert_readable(figure, width)
    top, res_x, res_y = figure.axes[:3]
    assert "(N)" in top.get_ylabel()
    assert top.get_xlim() == res_x.get_xlim() == res_y.get_xlim()


@pytest.mark.parametrize(("increments", "drawn"), [(150, 151), (450, 151)])
def test_every_reading_is_drawn_or_the_share_is_named(increments, drawn):
    figure = bands_figure(exact(specimen_of(increments=increments)), draws_of(20), width_mm=85.0)
    assert_readable(figure, 85.0)
    for ax in figure.axes:
        points = [line for line in ax.lines if line.get_linestyle() == "None"]
        assert points and {len(line.get_xdata()) for line in points} == {drawn}
    texts = [text for text, _ in in_view(figure)]
    assert ("one reading in 3 is drawn" in texts) == (increments == 450)


def test_true_loads_stand_on_the_bands():
    media = MATERIALS["donor2-media"].material
    truth = dict(zip(GOH_LAW.names, media.values, strict=True)) | MOUNTING
    specimen, draws = specimen_of(RATIOS[:2]), draws_of(50)
    zeroed = draws.drop(columns=[c for c in draws if c.startswith("mounting")])
    for table, mounting in ((draws, "noisy"), (zeroed, "zeroed")):
        posterior = exact(specimen, mounting=mounting)
        figure = bands_figure(posterior, table, truth=truth, width_mm=85.0)
        assert_readable(figure, 85.0)
        for k, p in enumerate(specimen.protocols):
            lines = [ln for ln in figure.axes[3 * k].lines if ln.get_color() == "black"]
            loads = media.piola(p.stretch_x * 1.009, p.stretch_y * 1.010)
            for line, load, area in zip(lines, loads, specimen.area, strict=True):
                force = load * area
                wanted = force - force[0] if mounting == "zeroed" else force
                np.testing.assert_allclose(line.get_ydata(), wanted, rtol=1e-12, atol=1e-15)
    assert "truth" in [text.get_text() for text in figure.legends[0].get_texts()]
    with pytest.raises(InputError, match="the true values lack alpha, mounting_stretch_x"):
        part = {k: v for k, v in truth.items() if k not in ("alpha", "mounting_stretch_x")}
        bands_figure(exact(specimen), draws, truth=part)


# --- mounting and traces --------------------------------------------------------------------


@pytest.mark.parametrize("width", [85.0, 180.0])
@pytest.mark.parametrize("states", [("",), tuple(f"{x:g}:{y:g}" for x, y in RATIOS)])
def test_mounting_figure_is_readable(width, states):
    specimen = specimen_of(RATIOS if len(states) > 1 else RATIOS[:1])
    draws = draws_of(2000, states=states)
    figure = mounting_figure(specimen, draws, truth=MOUNTING, width_mm=width)
    assert_readable(figure, width)
    assert len(figure.axes[1].get_yticks()) == 2 * len(states)


def test_posterior_and_reading_stand_where_they_are():
    specimen, draws = specimen_of(), draws_of(4000)
    reading = specimen.mounting_reading(specimen.protocols[0])
    draws["mounting_force_x"] = reading[0] + 0.001 * np.linspace(-1.0, 1.0, len(draws))
    ax = mounting_figure(specimen, draws).axes[1]
    assert "mN" in ax.get_xlabel()
    ends = [line.get_xdata() for line in ax.lines if len(np.atleast_1d(line.get_xdata())) == 2]
    assert any(np.allclose(e, [-0.9, 0.9], atol=1e-2) for e in ends)  # 90 % of +-1 mN
    noise = 0.6 * norm.ppf(0.95)
    assert any(np.allclose(e, [-noise, noise], atol=1e-9) for e in ends)


def chains_of(ensembles=4, steps=60, walkers=16, **shift) -> dict[str, np.ndarray]:
    draws = draws_of(ensembles * steps * walkers)
    chains = {str(k): v.to_numpy().reshape(ensembles, steps, walkers) for k, v in draws.items()}
    for name, value in shift.items():
        chains[name] = chains[name].copy()
        chains[name][0] += value
    return chains


@pytest.mark.parametrize("width", [85.0, 180.0])
def test_trace_figure_is_readable(width):
    chains = chains_of()
    figure = trace_figure(chains, unit="N", rhat={"C1": 1.0004, "lp": np.nan}, width_mm=width)
    assert_readable(figure, width)
    assert len(figure.axes) == 2 * 8


def test_ranks_show_the_ensemble_that_disagrees():
    figure = trace_figure(chains_of(kappa=0.5), names=["alpha", "kappa"])
    similar, apart = figure.axes[1], figure.axes[3]
    for ax, highest in ((similar, 1.5), (apart, 3.9)):
        heights = [patch.get_data().values for patch in ax.patches]
        assert len(heights) == 4
        assert all(np.mean(h) == pytest.approx(1.0) for h in heights)
        assert (max(h.max() for h in heights) > highest) == (ax is apart)
        assert ax.get_ylim()[0] == 0.0 and ax.get_ylim()[1] > max(h.max() for h in heights)
    with pytest.raises(InputError, match="unknown quantity 'beta'"):
        trace_figure(chains_of(), names=["beta"])


# --- style, files, names --------------------------------------------------------------------


@pytest.mark.long
def test_hostile_names_do_not_break_a_figure(tmp_path):
    p = specimen_of().protocols[0]
    names = (HOSTILE, "W" * 80, "$$", "x_{", "\\", "<svg>&amp;")
    tests = tuple(Protocol(n, p.stretch_x, p.stretch_y, p.load_x, p.load_y) for n in names)
    axes = {"axis_x": HOSTILE, "axis_y": "$\\alpha_{$"}
    specimen = Specimen(HOSTILE, tests, "force", "unloaded", 20.0, 20.0, 0.88, 0.0006, **axes)
    draws = draws_of(200, states=names)
    for figure, kind in (
        (bands_figure(exact(specimen), draws), "pdf"),
        (mounting_figure(specimen, draws), "svg"),
    ):
        assert_readable(figure, 180.0)
        save_figure(figure, tmp_path / f"figure.{kind}")
        assert (tmp_path / f"figure.{kind}").stat().st_size > 1000
    chains = {f"mounting_stretch_x[{HOSTILE}]": chains_of()["C1"]}
    known = Quantities(GOH_LAW.parameters, [PieceLabels(states=(HOSTILE,))])
    figure_bytes(trace_figure(chains, known=known), "pdf")


def test_files_are_reproducible_and_hold_their_fonts():
    figure = mounting_figure(specimen_of(), draws_of(300), width_mm=85.0)
    for kind in ("pdf", "svg", "png"):
        assert figure_bytes(figure, kind) == figure_bytes(figure, kind)
    pdf = figure_bytes(figure, "pdf")
    assert b"/FontFile2" in pdf and b"/Type3" not in pdf  # TrueType, embedded

    box = re.search(rb"/MediaBox \[ 0 0 ([0-9.]+) ", pdf)
    assert float(box.group(1)) == pytest.approx(85.0 / 25.4 * 72.0, abs=0.01)
    svg = figure_bytes(figure, "svg")
    written = re.sub(rb"<[^>]*>", b"", b"".join(re.findall(rb"<text.*?</text>", svg, re.S)))
    assert b"mounting force less its reading" in written  # letters, no outlines
    with print_style({"svg.fonttype": "path"}):
        outlines = figure_bytes(figure, "svg")
    assert b"<text" not in outlines and b"font-family" not in outlines


def test_a_style_file_changes_fonts_and_colours(tmp_path):
    path = tmp_path / "journal.mplstyle"
    path.write_text(
        "font.family: serif  # as the journal wants it\n"
        "axes.prop_cycle: cycler('color', ['112233', '445566'])\n"
        "xtick.labelsize: 7.5\nbackend: TkAgg\nsavefig.bbox: tight\n"
    )
    with print_style(read_style(path)):
        figure = bands_figure(exact(specimen_of()), draws_of(50), width_mm=85.0)
        pdf = figure_bytes(figure, "pdf")
    assert figure.axes[0].lines[0].get_color() == "#112233"
    assert figure.axes[2].get_xticklabels()[0].get_fontsize() == 7.5
    assert figure.axes[2].xaxis.label.get_fontfamily() == ["serif"]
    box = re.search(rb"/MediaBox \[ 0 0 ([0-9.]+) ", pdf)
    assert float(box.group(1)) == pytest.approx(85.0 / 25.4 * 72.0, abs=0.01)


def test_a_wrong_style_file_is_named_with_its_row(tmp_path):
    path = tmp_path / "wrong.mplstyle"
    for line, message in (
        ("axes.linewidht: 1", "'axes.linewidht' is not a setting"),
        ("axes.linewidth: thick", "does not accept"),
        ("text.usetex: True", "cannot be used"),
    ):
        path.write_text(f"font.size: 8\n{line}\n")
        with pytest.raises(InputError, match=f"wrong.mplstyle.*{message}"):
            read_style(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_style(tmp_path / "absent.mplstyle")


def test_truth_files(tmp_path):
    path = tmp_path / "truth.json"
    path.write_text('{"C1": 2.98, "kappa": 0}')
    assert read_truth(path, "any") == {"C1": 2.98, "kappa": 0.0}
    entry = {"material": {"C1_kPa": 1.0, "alpha_deg": 39.0}, "mounting_stretch_x": 1.009}
    path.write_text(json.dumps({"a": entry, "b": entry}))
    assert read_truth(path, "b") == {"C1": 1.0, "alpha": 39.0, "mounting_stretch_x": 1.009}
    with pytest.raises(InputError, match="no entry for specimen"):
        read_truth(path, "c")
    for text in ("[1]", "{", '{"C1": "x"}', '{"C1": NaN}', "{}"):
        path.write_text(text)
        with pytest.raises(InputError) as caught:
            read_truth(path, "a")
        assert "truth.json" in str(caught.value)


# --- figures of predictions ---


def tube_table(by: str) -> pd.DataFrame:
    n = 9
    d, p = np.linspace(20.0, 24.0, n), np.linspace(0.0, 16.0, n)
    table = {"pressure_kPa": p} if by == "pressure" else {"outer_diameter_mm": d}
    name, middle = ("outer_diameter_mm", d) if by == "pressure" else ("pressure_kPa", p)
    for band, shift in zip(BANDS, (0.0, -0.2, 0.2, -0.5, 0.5), strict=True):
        table[f"{name}_{band}"] = middle + shift
    return pd.DataFrame({**table, "extrapolation": [INSIDE] * 4 + [BEYOND] * 5})


def drawn(ax, style):
    lines = [line for line in ax.lines if line.get_linestyle() == style]
    return [line.get_xydata() for line in lines if len(line.get_xdata())]


@pytest.mark.parametrize("by", ["pressure", "diameter"])
def test_inflation_has_both_units_of_pressure(by):
    figure = inflation_figure(tube_table(by))
    ax, strip = figure.axes
    figure.draw_without_rendering()
    low, high = ax.get_ylim()
    (right,) = (ax if by == "diameter" else strip).child_axes
    assert right.get_ylabel() == "pressure (mmHg)"
    assert right.get_ylim() == pytest.approx((low * 7.500617, high * 7.500617))
    (solid,), (dashed,) = drawn(ax, "-"), drawn(ax, "--")
    assert solid[0] == pytest.approx([20.0, 0.0]) and dashed[-1] == pytest.approx([24.0, 16.0])
