"""Damaged input of every kind ends in a reading or in one line."""

from __future__ import annotations

import pytest

from hostile.readers import READERS, hammer


@pytest.mark.parametrize("reader", READERS)
def test_damaged_input_is_read_or_refused(reader, bases, tmp_path):
    found = hammer(reader, 1, 50, tmp_path, bases)
    assert found.problems == []
    assert found.inputs == 50 and found.refused > 10


# Options of sample have no input but the damage.
@pytest.mark.parametrize("reader", [r for r in READERS if r != "options of sample"])
def test_what_is_not_damaged_is_read(reader, bases, tmp_path, monkeypatch):
    """Or the trials would say nothing: without damage nothing may be refused."""
    monkeypatch.setattr("hostile.readers.mutated_bytes", lambda rng, data, *a, **k: data)
    monkeypatch.setattr("hostile.readers.mutated_table", lambda rng, table, *a, **k: table)
    monkeypatch.setattr("hostile.readers.damage", lambda rng, parts, key: parts)
    monkeypatch.setattr("hostile.readers.REPLACED", 0.0)
    found = hammer(reader, 1, 12, tmp_path, bases)
    assert (found.problems, found.refused, found.read) == ([], 0, 12)
