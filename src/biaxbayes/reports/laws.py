"""What a comparison of laws writes: tables, figures, a page, and the terminal's text."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from biaxbayes.comparison.law_weights import MIXTURE, LawComparison
from biaxbayes.figures.comparisons import by_weight, law_misfit_figure, law_mounting_figure
from biaxbayes.figures.style import figure_bytes, save_pictures
from biaxbayes.parameters import STRETCH, Quantities, Quantity
from biaxbayes.report_table import DASH, Column, Row, Table, interval_texts, quantiles_of
from biaxbayes.reports.page import (
    Block,
    Section,
    captioned,
    embedded,
    page_html,
    paragraph,
    prose,
    remarks,
)
from biaxbayes.text_files import atomic_write_text, write_csv

PAGE = "laws.html"
TERMS = (
    *("material laws", "residual, misfit", "weight of a law", "density of what was left out"),
    *("nats", "mounting stretch", "median, 90 % interval", "converged, tentative, unusable"),
)


def write_law_comparison(compared: LawComparison, folder: Path) -> None:
    """Write tables, figures and the page."""
    write_csv(folder / "laws.csv", compared.table, digits=8)
    write_csv(folder / "left-out.csv", compared.parts, digits=8)
    figures = {"law-misfit": law_misfit_figure(compared)}
    if (mounting := law_mounting_figure(compared)) is not None:
        figures["law-mounting"] = mounting
    for stem, figure in figures.items():
        save_pictures(figure, folder, stem)
    atomic_write_text(folder / PAGE, laws_page(compared, figures))


def laws_table(compared: LawComparison) -> Table:
    """The laws by weight, the mixture last, with the mounting stretches."""

    def weight(r: Row) -> str:
        if pd.isna(r["weight"]):
            return DASH
        known = not pd.isna(r["weight_low"])
        ends = f" ({r['weight_low']:.2f} to {r['weight_high']:.2f})" if known else ""
        return f"{r['weight']:.2f}{ends}"

    def stretch(q: Quantity, r: Row) -> str:
        middle, first, last = interval_texts(*quantiles_of(r, q.name), q.parameter)
        return DASH if middle == DASH else f"{middle}, {first} to {last}"

    mounting = Quantities(()).of_kind(STRETCH)
    columns = [
        Column("law", "Law"),
        Column("state", "Chains"),
        Column("rms_kPa", "Misfit", "kPa", ".3g", number=True, term=True),
        Column("left_out_rms_kPa", "Left out", "kPa", ".3g", number=True),
        Column("left_out_density_nats", "Density", "nats", ".1f", number=True, term=True),
        Column("weight", "Weight", format=weight, number=True, term=True),
        *(
            Column(q.name, q, format=partial(stretch, q), number=True)
            for q in mounting
            if f"{q.name}_q50" in compared.table
        ),
    ]
    caption = "Laws by weight; mounting stretches: median and 90 % interval"
    return Table(columns, by_weight(compared.table), "Laws", caption)


def _parts_table(parts: pd.DataFrame) -> Table:
    """How well the mixture and the best law predict each part."""
    rows = []
    for name, part in parts.groupby("part", sort=False):
        mixture = part[part["law"] == MIXTURE].iloc[0]
        best = part[part["law"] != MIXTURE].sort_values("left_out_rms_kPa").iloc[0]
        misfits = mixture["left_out_rms_kPa"], best["left_out_rms_kPa"]
        rows.append((name, misfits[0], best["law"], misfits[1], mixture["readings"]))
    columns = [
        Column("part", "Part"),
        Column("misfit", "Misfit", "kPa", ".3g", number=True, term=True),
        Column("best", "Best law"),
        Column("misfit_of_best", "Its misfit", "kPa", ".3g", number=True),
        Column("readings", "Readings", format=".0f", number=True),
    ]
    caption = "The mixture whose weights are from the other parts, and the best law"
    frame = pd.DataFrame(rows, columns=[c.name for c in columns])
    return Table(columns, frame, "Parts left out", caption)


def laws_page(compared: LawComparison, drawings: Mapping[str, Figure]) -> str:
    """The page of a comparison of laws, with its figures by the stems of their files."""
    figures = {name: embedded(figure_bytes(figure, "png")) for name, figure in drawings.items()}
    table = compared.table
    best = table[table["law"] != MIXTURE].sort_values("left_out_rms_kPa").iloc[0]
    mixture = table.set_index("law").loc[MIXTURE]
    left = [f"{law} is left out: {why}" for law, why in sorted(compared.left_out.items())]
    weights = [
        remarks("Not every law could be sampled.", left),
        paragraph(
            f"Of the laws, {best['law']} predicts left-out parts best: its rms error is "
            f"{best['left_out_rms_kPa']:.3g} kPa, that of the mixture of all laws "
            f"{mixture['left_out_rms_kPa']:.3g} kPa."
        ),
        captioned(
            figures["law-misfit"],
            "Misfit of every law to the record and to the parts left out, and its weight",
            prose(
                "Open: [misfit] of the fit to all; filled: of parts left out. Right: [weight], "
                "with its range when a part is dropped."
            ),
        ),
        laws_table(compared),
    ]
    mounting: list[Block] = []
    if "law-mounting" in figures:
        about = prose(
            "What each law says is in the table above. Weights hold for tested stretches, not "
            "between the unloaded and the mounted state: where laws of some weight disagree, "
            "measure the mounting stretch."
        )
        caption = prose(
            "Median and 90 % [interval] of every law; grey symbols: laws with a weight below 0.05."
        )
        mounting = [
            paragraph(about),
            captioned(figures["law-mounting"], "Mounting stretches by law", caption),
        ]
    files = "laws.csv: one row per law, the last one the mixture. left-out.csv: every law on every "
    sections = [
        Section("weights", "Misfit and weight", weights),
        Section("mounting", "Mounting stretch", mounting),
        Section("parts", "Parts left out", [_parts_table(compared.parts)]),
        Section("files", "Files", [paragraph(f"{files}part.")]),
    ]
    about = prose(
        f"{len(table) - 1} [material laws] fitted to one record, and weighted by how well they "
        "predict the parts of it that were left out of the fit"
    )
    return page_html("laws", compared.specimen, about, sections, TERMS)


def laws_text(compared: LawComparison, folder: Path) -> str:
    """The laws by weight, the mixture last, with the mounting stretches."""
    return "\n".join(laws_table(compared).lines()) + (
        "\n\nmisfit: error (rms) of the fit to all rows; left out: error of predicting the parts\n"
        "left out; density: log predictive density of these, larger is better (2.3 nats more: ten\n"
        "times as probable); weight: fraction in the mixture that predicts best (stacking);\n"
        "mounting stretches: median, 90 % interval. Weights hold for tested stretches, not below\n"
        "the mounted state: where laws disagree on the mounting stretch, measure it.\n\n"
        f"open {folder / PAGE}; tables and figures are beside it"
    )
