"""Exported material cards against hand calculation, the paper's tables and the draws."""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from biaxbayes.cards.abaqus import write_abaqus
from biaxbayes.cards.card import UNIT_SYSTEMS, Card, exportable
from biaxbayes.cards.export import MANIFEST, export_cards
from biaxbayes.cards.febio import write_febio
from biaxbayes.errors import InputError
from biaxbayes.laws import law_named
from biaxbayes.laws.goh import GOH, GOHLaw
from biaxbayes.laws.published import MATERIALS
from biaxbayes.prediction.draws import chosen_draws, common_states, median_draw
from biaxbayes.specimens.specimen import Specimen
from card_readers import READ, biaxial_stress, read_abaqus, read_febio
from goh_functions import GOH_LAW
from quick_posteriors import exact_specimen

MEDIA = MATERIALS["weisbecker-media"].material
WRITE = {"abaqus": write_abaqus, "febio": write_febio}
PER_KPA = {"kPa-mm": 1.0, "MPa-mm": 1e-3, "Pa-m": 1e3}


def card(material: GOH = MEDIA, units: str = "kPa-mm", bulk: float | None = 1e5, **more) -> Card:
    return Card("media", material, UNIT_SYSTEMS[units], bulk, **more)


def stress(program: str, made: Card, x, y) -> np.ndarray:
    """Stress of a card from its text, in the card's unit."""
    return np.array(biaxial_stress(READ[program](WRITE[program](made, "1.0")).energy, x, y))


def specimen(name="media", ratios=((1.0, 1.0),), lm=(1.01, 1.02)) -> Specimen:
    return replace(exact_specimen(MEDIA, mounting_stretch=lm, ratios=ratios), name=name)


def draws(n: int, seed=0) -> pd.DataFrame:
    """As scattered as a posterior can be: from soft to stiff, aligned to isotropic."""
    rng = np.random.default_rng(seed)
    low, high = np.log([[0.1, 0.1, 0.01], [80.0, 300.0, 150.0]])
    C1, k1, k2 = np.exp(rng.uniform(low, high, (n, 3))).T
    stretch_x, stretch_y = rng.uniform(1.0, 1.03, (2, n))
    columns = {"C1": C1, "k1": k1, "k2": k2, "alpha": rng.uniform(0.0, 90.0, n)}
    columns |= {"kappa": rng.uniform(0.0, 1.0 / 3.0, n), "mounting_stretch_x": stretch_x}
    columns |= {"mounting_stretch_y": stretch_y, "noise_sd": np.full(n, 0.01)}
    return pd.DataFrame(columns | {"lp": rng.normal(size=n)})


# --- laws that FEBio has as a mixture ---

FUNG = {"c0": 10.0, "c": 5.0, "b_x": 8.0, "b_y": 5.0, "b_xy": 2.0}
FUNG_BACK = {"c0": 1.0, "c": 20.0, "b_x": 30.0, "b_y": 3.0, "b_xy": -4.0}
FIBRES = {
    **{"c": 18.536, "k1_x": 16.593, "k2_x": 0.108, "k1_y": 25.37, "k2_y": 0.036},
    **{"k1_d": 0.078, "k2_d": 1.719, "alpha": 61.2146},
}
MIXTURES = [
    *(("fung", FUNG), ("fung", FUNG_BACK), ("four-fibre", FIBRES)),
    ("four-fibre", FIBRES | {"k1_x": 0.0, "k2_y": 0.0}),
    ("fung", FUNG | {"c": 0.0}),
]


def mixtures(law: str, values: dict[str, float], out, units="kPa-mm"):
    frame = pd.DataFrame([values]).assign(mounting_stretch_x=1.01, mounting_stretch_y=1.02)
    manifest = export_cards(
        frame, specimen(), law_named(law), [0], out, program="febio", units=units
    )
    return manifest, (out / manifest["file"][0]).read_text()


@pytest.mark.parametrize("units", sorted(UNIT_SYSTEMS))
@pytest.mark.parametrize(("law", "values"), MIXTURES)
def test_mixtures_agree_with_the_law_at_twenty_states(law, values, units, tmp_path):
    manifest, text = mixtures(law, values, tmp_path, units)
    for p in law_named(law).parameters:
        assert manifest[p.label][0] == pytest.approx(values[p.name], rel=1e-14)
    x, y = np.random.default_rng(3).uniform(0.9, 1.25, (2, 20))
    ours = np.array(law_named(law).checked_material(values).cauchy(x, y)) * PER_KPA[units]
    read = read_febio(text)
    # nearly incompressible: the volume does no work in a state without change of volume
    for energy, least in ((read.isochoric_energy, 1e-9), (read.energy, 1e-6)):
        got = biaxial_stress(energy, x, y)
        np.testing.assert_allclose(got, ours, rtol=1e-6, atol=least * np.abs(ours).max())


def test_what_a_mixture_says_by_hand(tmp_path):
    _, text = mixtures("fung", FUNG | {"b_xy": 0.0}, tmp_path)
    root = ElementTree.fromstring(text.encode())
    assert root.find("Material/material").get("type") == "uncoupled solid mixture"
    assert [s.get("type") for s in root.iter("solid")] == ["Mooney-Rivlin", "Fung orthotropic"]
    # without coupling the plane's moduli are c b_x and c b_y, the shear moduli their mean over two
    wanted = {"c1": 10, "c2": 0, "c": 5, "E1": 40, "E2": 25, "v12": 0, "G12": 16.25, "G31": 16.25}
    for name, value in wanted.items():
        assert float(next(root.iter(name)).text) == pytest.approx(value, abs=1e-12)
    assert "NOT SEEN BY THE TEST" in text and "G12, G23, G31" in text

    _, text = mixtures("four-fibre", FIBRES, tmp_path / "fibres")
    solids = list(ElementTree.fromstring(text.encode()).iter("solid"))
    fibres = [s for s in solids if s.get("type") == "fiber-exp-pow-uncoupled"]
    assert float(solids[0].findtext("c1")) == 18.536 / 2
    assert [float(s.findtext("ksi")) for s in fibres] == [16.593 / 2, 25.37 / 2, 0.039, 0.039]
    assert [float(s.findtext("alpha")) for s in fibres] == [0.108, 0.036, 1.719, 1.719]
    directions = [[float(v) for v in s.findtext("fiber").split(",")] for s in fibres]
    c, s = np.cos(np.radians(61.2146)), np.sin(np.radians(61.2146))
    np.testing.assert_allclose(
        directions, [[1, 0, 0], [0, 1, 0], [c, s, 0], [c, -s, 0]], atol=1e-15
    )


# What FEBio 4.0 to 4.11 accepts inside a material, from the parameter lists of its sources:
# positive parameters, those that may be zero, any number; its properties. The bulk modulus k
# belongs to the outermost material alone.
FEBIO = {
    "Holzapfel-Gasser-Ogden": ("", "c k1 k2 kappa", "gamma", {"mat_axis"}),
    "uncoupled solid mixture": ("", "", "", {"mat_axis", "solid"}),
    "Mooney-Rivlin": ("", "", "c1 c2", set()),
    "fiber-exp-pow-uncoupled": ("", "alpha beta ksi", "", {"fiber"}),
    "Fung orthotropic": ("E1 E2 E3 c", "G12 G23 G31", "v12 v23 v31", {"mat_axis"}),
}


def assert_febio_accepts(node: ElementTree.Element, *, outermost: bool = True) -> None:
    positive, not_negative, any_number, properties = FEBIO[node.get("type")]
    parameters = set(f"{positive} {not_negative} {any_number}".split()) | (
        {"k"} if outermost else set()
    )
    tags = [child.tag for child in node]
    assert set(tags) <= parameters | properties
    assert parameters <= set(tags)
    assert all(tags.count(tag) == 1 for tag in set(tags) - {"solid"})
    for child in node:
        if child.tag == "solid":
            assert_febio_accepts(child, outermost=False)
        elif child.tag == "mat_axis":
            assert child.attrib == {"type": "vector"}
            assert [(c.tag, len(c.text.split(","))) for c in child] == [("a", 3), ("d", 3)]
        elif child.tag == "fiber":
            assert child.attrib == {"type": "vector"} and not len(child)
            assert np.linalg.norm([float(v) for v in child.text.split(",")]) == pytest.approx(1.0)
        else:
            value = float(child.text)
            assert not child.attrib and not len(child)
            assert np.isfinite(value)
            assert value > 0.0 or child.tag not in (*positive.split(), "k")
            assert value >= 0.0 or child.tag not in not_negative.split()
            assert value <= 1.0 / 3.0 or child.tag != "kappa"
            assert value >= 2.0 or child.tag != "beta"
    if node.get("type") == "fiber-exp-pow-uncoupled":
        assert "fiber" in tags


@pytest.mark.parametrize(
    ("law", "values"),
    [*MIXTURES, ("goh", {"C1": 5.0, "k1": 20.0, "k2": 0.0, "alpha": 90.0, "kappa": 1.0 / 3.0})],
)
def test_febio_accepts_every_tag_of_a_card(law, values, tmp_path):
    _, text = mixtures(law, values, tmp_path)
    root = ElementTree.fromstring(text.encode())
    assert (root.tag, root.attrib) == ("febio_spec", {"version": "4.0"})
    assert [child.tag for child in root] == ["Module", "Material"]
    assert_febio_accepts(root.find("Material/material"))


def test_the_axes_of_a_mixture_turn_all_its_parts(tmp_path):
    """Where the first axis is along y, the stresses of x and y change places."""
    for law, values in (("fung", FUNG), ("four-fibre", FIBRES)):
        _, text = mixtures(law, values, tmp_path / law)
        turned = text.replace("<a>1,0,0<", "<a>0,1,0<").replace("<d>0,1,0<", "<d>-1,0,0<")
        x, y = biaxial_stress(read_febio(turned).isochoric_energy, 1.2, 1.1)
        sx, sy = law_named(law).checked_material(values).cauchy(1.1, 1.2)
        assert (x[0], y[0]) == pytest.approx((sy, sx), rel=1e-8)


@pytest.mark.parametrize(
    ("law", "program", "message"),
    [
        ("fung", "abaqus", "c0 is above zero here; export it to febio"),
        ("four-fibre", "abaqus", "law four-fibre for abaqus; export it to febio"),
        ("may-newman", "febio", "law may-newman for febio"),
    ],
)
def test_laws_that_a_program_does_not_have(law, program, message, tmp_path):
    values = FUNG if law == "fung" else dict.fromkeys(law_named(law).names, 1.0)
    frame = pd.DataFrame([values])
    with pytest.raises(InputError, match=message):
        export_cards(frame, specimen(), law_named(law), [0], tmp_path, program=program)
    assert not any(tmp_path.iterdir())


# --- hand calculation, per program ---
#
# Media of Table 1 (C1 14 kPa, k1 140 kPa, k2 11.9, alpha 38.4 deg, kappa 0.21), stretch 1.2 both
# ways, so C = diag(1.44, 1.44, 0.4822530864), I1 = 3.3622530864 and I4 = 1.44 in both families:
#   E  = 0.21 * 0.3622530864 + 0.37 * 0.44                  = 0.2388731481
#   exp(11.9 E^2) = exp(0.6790185328)                       = 1.9719413863
#   e = 4 k1 E exp = 560 * 0.2388731481 * 1.9719413863      = 263.7845543
#   cos^2 38.4 deg = 0.6141754351: Hx = 0.4372449110, Hy = 0.3527550890, Hz = 0.21
#   s_x = (28 + Hx e) 1.44 - (28 + 0.21 e) 0.4822530864     = 166.18999502 kPa
#   s_y = the same with Hy                                  = 134.09655659 kPa
HAND = (166.18999502225, 134.09655659152)


@pytest.mark.parametrize("units", UNIT_SYSTEMS)
@pytest.mark.parametrize("program", WRITE)
def test_media_of_table_1_at_stretch_1_2(program, units):
    got = stress(program, card(units=units), 1.2, 1.2)[:, 0]
    np.testing.assert_allclose(got, np.array(HAND) * PER_KPA[units], rtol=1e-11)


def test_abaqus_data_line_holds_C10_D_k1_k2_kappa():
    lines = write_abaqus(card(units="MPa-mm", bulk=None), "1.0").splitlines()
    keyword = lines.index("*ANISOTROPIC HYPERELASTIC, HOLZAPFEL, LOCAL DIRECTIONS=2")
    numbers = [float(v) for v in lines[keyword + 1].split(",")]
    assert numbers == [0.014, 0.0, 0.14, 11.9, 0.21]  # C10 = C1, MPa; incompressible
    first = next(i for i, line in enumerate(lines) if line.startswith("*ORIENTATION"))
    assert lines[first].endswith("LOCAL DIRECTIONS=2")
    # cos and sin of 38.4 degrees
    assert lines[first + 3].startswith("7.83693457") and "6.21147780" in lines[first + 3]
    assert "-6.21147780" in lines[first + 4]
    text = write_abaqus(card(units="Pa-m", bulk=5e4), "1.0")
    D = float(text.splitlines()[-1].split(",")[1])
    assert pytest.approx(2.0 / 5e7, rel=1e-12) == D  # two over the bulk modulus
    assert read_abaqus(text).bulk == pytest.approx(5e7, rel=1e-12)


def test_febio_c_is_twice_C1_and_gamma_is_in_degrees():
    root = ElementTree.fromstring(write_febio(card(units="MPa-mm", bulk=5e4), "1.0"))
    node = root.find("Material/material")
    values = {child.tag: float(child.text) for child in node if child.tag != "mat_axis"}
    by_hand = {"c": 0.028, "k1": 0.14, "k2": 11.9, "gamma": 38.4, "kappa": 0.21, "k": 50.0}
    assert values == pytest.approx(by_hand)
    assert (node.findtext("mat_axis/a"), node.findtext("mat_axis/d")) == ("1,0,0", "0,1,0")
    with pytest.raises(InputError, match="bulk"):
        write_febio(card(bulk=None), "1.0")
    with pytest.raises(InputError, match="C1 is zero"):
        exportable(GOH(0.0, 10.0, 1.0, 40.0, 0.1))


# --- every law and unit system ---


@pytest.mark.parametrize("units", UNIT_SYSTEMS)
@pytest.mark.parametrize("program", WRITE)
@pytest.mark.parametrize("law", ["goh", "hgo"])
def test_cards_of_sixty_draws_agree_with_the_closed_form(law, program, units, tmp_path):
    frame = draws(60).assign(**({} if law == "goh" else {"kappa": 0.0}))
    sample = specimen(ratios=((1.0, 1.0), (1.0, 0.4)))
    manifest = export_cards(
        frame, sample, law_named(law), range(60), tmp_path, program=program, units=units
    )
    assert len(manifest) == 60
    assert manifest["weight"].sum() == pytest.approx(1.0)
    path = np.linspace(1.0, 1.2, 9)
    for row, file in enumerate(manifest["file"]):
        energy = READ[program]((tmp_path / file).read_text()).isochoric_energy
        got = np.array(biaxial_stress(energy, path, path[::-1]))
        C1, k1, k2, alpha, kappa = frame.iloc[row, :5]
        expected = GOH(C1, k1, k2, alpha, kappa, fibre_switch=True).cauchy(path, path[::-1])
        np.testing.assert_allclose(got / PER_KPA[units], expected, rtol=1e-8, atol=1e-8)


def test_orientation_of_the_geometry_is_honoured():
    """Axes swapped: what was stress in x is stress in y."""
    text = write_abaqus(card(), "1.0").replace("1., 0., 0., 0., 1., 0.", "0., 1., 0., -1., 0., 0.")
    x, y = biaxial_stress(read_abaqus(text).energy, 1.2, 1.2)
    assert (y[0], x[0]) == pytest.approx(HAND, rel=1e-11)
    text = write_febio(card(), "1.0").replace("1,0,0", "0,2,0").replace("0,1,0", "-1,1,0", 1)
    x, y = biaxial_stress(read_febio(text).energy, 1.2, 1.2)
    assert (y[0], x[0]) == pytest.approx(HAND, rel=1e-11)


def test_bulk_modulus_limits_the_change_of_volume(tmp_path):
    """Free thickness instead of the incompressible limit, ratio 1000: J - 1 is about p / K."""
    frame = draws(1).assign(C1=14.0, k1=140.0, k2=11.9, alpha=38.4, kappa=0.21)
    manifest = export_cards(frame, specimen(), GOH_LAW, [0], tmp_path, program="febio")
    energy = read_febio((tmp_path / manifest["file"][0]).read_text()).energy
    lz, h = 1.0 / (1.18 * 1.18), 1e-30
    for _ in range(40):  # Newton for s_zz = 0, slope by differences of complex steps
        slopes = []
        for z in (lz, lz * (1.0 + 1e-7)):
            F = np.diag([1.18, 1.18, z]).astype(complex)[None]
            F[0, 2, 2] += 1j * h
            slopes.append(energy(F)[0].imag / h)
        lz -= slopes[0] / ((slopes[1] - slopes[0]) / (lz * 1e-7))
    assert abs(1.18 * 1.18 * lz - 1.0) < 2e-3
    assert abs(1.18 * 1.18 * lz - 1.0) > 1e-5


# --- ends of the ranges of the parameters ---


@pytest.mark.parametrize("program", WRITE)
@pytest.mark.parametrize("end", [{"k2": 0.0}, {"kappa": 0.0}, {"kappa": 1 / 3}, {"alpha": 90.0}])
def test_ends_of_ranges_are_exported(program, end, tmp_path):
    values = {"C1": 5.0, "k1": 20.0, "k2": 2.0, "alpha": 40.0, "kappa": 0.1} | end
    frame = draws(1).assign(**values)
    manifest = export_cards(frame, specimen(), GOH_LAW, [0], tmp_path, program=program)
    text = (tmp_path / manifest["file"][0]).read_text()
    assert ("k2 = 0 is written as 1e-09" in text) == ("k2" in end)
    result = READ[program](text)
    assert result.solids[0].values["kappa"] <= 1.0 / 3.0
    got = np.array(biaxial_stress(result.isochoric_energy, 1.2, 1.1))[:, 0]
    expected = GOH(*values.values(), fibre_switch=True).cauchy(1.2, 1.1)
    np.testing.assert_allclose(got, expected, rtol=1e-8)


def test_negative_fibre_strain_is_a_warning_in_card_and_manifest(tmp_path):
    """Fibres along y, test mostly along x: E < 0, where fit and program differ."""
    frame = draws(1).assign(C1=5.0, k1=50.0, k2=2.0, alpha=90.0, kappa=0.0)
    sample = specimen(ratios=((1.0, 0.0),), lm=(1.0, 0.95))
    frame = frame.assign(mounting_stretch_x=1.0, mounting_stretch_y=0.95)
    plain = export_cards(frame, sample, GOH_LAW, [0], tmp_path / "a", program="abaqus")
    E = 0.95**2 - 1.0
    assert plain["smallest_fibre_strain"][0] == pytest.approx(E)
    # s_y loses 4 k1 E exp(k2 E^2) ly^2; s_x loses nothing (kappa = 0, fibres along y)
    lost = 4.0 * 50.0 * abs(E) * np.exp(2.0 * E**2) * 0.95**2
    assert plain["switch_changes_stress_kPa"][0] == pytest.approx(lost)
    text = (tmp_path / "a" / plain["file"][0]).read_text()
    assert "WARNING: E falls to -0.0975" in text
    switched = export_cards(frame, sample, GOHLaw(True), [0], tmp_path / "b", program="abaqus")
    assert switched["switch_changes_stress_kPa"][0] == 0.0
    assert "WARNING" not in (tmp_path / "b" / switched["file"][0]).read_text()


# --- hostile text, files ---

HOSTILE = [
    "x\n*MATERIAL, NAME=EVIL\n*ELASTIC\n1.,0.",
    "--><material/><!-- a--->b",
    "../../etc/passwd",
    "größe 1 µm — ✓ \x00\x1b[31m\u2028*STEP",
    "a" * 5000,
    "",
]


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("program", WRITE)
def test_hostile_names_stay_inside_a_comment(program, name, tmp_path):
    manifest = export_cards(
        draws(2), specimen(name), GOH_LAW, [1], tmp_path, program=program, origin=name
    )
    file = tmp_path / manifest["file"][0]
    assert file.parent == tmp_path and re.fullmatch(r"[A-Za-z0-9_]+-\d{4}\.\w+", file.name)
    text = file.read_text(encoding="ascii")
    assert "\r" not in text and "\0" not in text
    lines = text.splitlines()
    assert max(map(len, lines)) <= 256
    if program == "abaqus":
        keywords = [line.split(",")[0] for line in lines if re.match(r"\*[^*]", line)]
        assert keywords == ["*ORIENTATION", "*MATERIAL", "*ANISOTROPIC HYPERELASTIC"]
        assert len(lines) - sum(line.startswith("**") for line in lines) == 8
        assert len(read_abaqus(text).label) <= 80
    else:
        assert len(list(ElementTree.fromstring(text).iter("material"))) == 1
        assert text.count("<!--") == 1 == text.count("-->")


@pytest.mark.parametrize("reader", READ.values())
@pytest.mark.parametrize("text", ["", "hello", "*MATERIAL, NAME=A\n*ELASTIC\n1.,.3", "<a/>"])
def test_other_files_are_no_cards(reader, text):
    with pytest.raises(ValueError, match="not a material card"):
        reader(text)


def test_an_earlier_export_is_neither_mixed_with_nor_lost(tmp_path):
    keep = tmp_path / "notes.txt"
    export_cards(draws(4), specimen(), GOH_LAW, [0, 1, 2], tmp_path, program="abaqus")
    keep.write_text("mine")
    with pytest.raises(InputError, match="earlier export"):
        export_cards(draws(4), specimen(), GOH_LAW, [3], tmp_path, program="febio")
    export_cards(draws(4), specimen(), GOH_LAW, [3], tmp_path, program="febio", overwrite=True)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [MANIFEST, "media-0003.feb", "notes.txt"]


def test_the_manifest_leads_from_card_to_draw(tmp_path):
    frame = draws(30)
    export_cards(frame, specimen(), GOH_LAW, [4, 7], tmp_path, program="abaqus", units="Pa-m")
    manifest = pd.read_csv(tmp_path / MANIFEST)
    assert manifest["draw"].tolist() == [4, 7]
    assert manifest["weight"].tolist() == [0.5, 0.5]
    np.testing.assert_allclose(manifest["k1_kPa"], frame["k1"].iloc[[4, 7]], rtol=1e-15)
    for _, row in manifest.iterrows():
        result = read_abaqus((tmp_path / row["file"]).read_text())
        assert result.label == row["card"].upper()
        k1 = result.solids[0].values["k1"]
        assert k1 == pytest.approx(1000.0 * row["k1_kPa"], rel=1e-12)


# --- which draw ---


def test_median_draw_is_a_draw_near_the_median_curves_where_the_median_vector_is_not():
    """C1 and k1 trade with each other: the medians of the two stiffen nobody's curve."""
    rng = np.random.default_rng(4)
    frame = draws(301).assign(k2=1.0, alpha=45.0, kappa=0.1)
    frame["mounting_stretch_x"] = frame["mounting_stretch_y"] = 1.01
    share = rng.permutation(np.linspace(0.02, 0.98, 301))
    frame["C1"], frame["k1"] = 20.0 * share, 60.0 * (1.0 - share)
    row = median_draw(frame, specimen(), GOH_LAW)
    states = common_states(frame, specimen())[0]
    curves = np.array(
        [np.concatenate(GOH(*frame.iloc[i, :5]).piola(*states.T)) for i in range(301)]
    )
    median = np.median(curves, axis=0)
    distance = ((curves - median) ** 2).sum(axis=1)
    assert distance[row] <= np.quantile(distance, 0.02)
    assert share[row] == pytest.approx(0.5, abs=0.1)


def test_random_draws_repeat_with_the_seed():
    frame = draws(40)

    def rows(count: int) -> list[int]:
        return chosen_draws(frame, specimen(), GOH_LAW, count=count, seed=3)[0]

    assert rows(10) == rows(10) == sorted(set(rows(10))) and len(rows(10)) == 10
    assert rows(40) == list(range(40))
    for count in (0, 41):
        with pytest.raises(InputError, match="the run has 40"):
            rows(count)
