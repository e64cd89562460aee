"""The comparison of records, and that every record is compared."""

import pytest
import records
from records import EXPECTED, PARTS, changes, expected, same, shown, table


def test_each_record_is_expected_and_compared_once():
    groups = sorted(group for part in PARTS.values() for group in part)
    assert (
        groups == sorted({each.group for each in table()}) == sorted(path.stem for path in EXPECTED.iterdir())
    )
    for group in groups:
        assert [*expected(group)] == [each.name for each in table() if each.group == group]
        assert all(expected(group).values())


@pytest.mark.parametrize(
    ("column", "old", "new", "is_same"),
    [
        ("json:energy_end_kj_mol", "-1234.567890", "-1234.567899", True),
        ("json:energy_end_kj_mol", "-1234.567890", "-1234.569890", False),
        ("json:energy_cmap_end_kj_mol", "0", "9e-07", True),
        (
            "end.pdb:atom_10_angstrom",
            "A:2:TYR:N 1.00000 2.00000 3.00000",
            "A:2:TYR:N 1.00009 2.00000 3.00000",
            True,
        ),
        (
            "end.pdb:atom_10_angstrom",
            "A:2:TYR:N 1.00000 2.00000 3.00000",
            "A:2:TYR:N 1.00020 2.00000 3.00000",
            False,
        ),
        ("end.pdb:atom_10_angstrom", "A:2:TYR:N 1 2 3", "A:2:TYR:CA 1 2 3", False),
        ("json:evaluations", "12000000", "12000001", False),
        ("json:status", "budget", "converged", False),
        ("json:inverted", "2 ALA A", "", False),
        ("rows.csv:median", "2 1", "nan 1", False),
    ],
)
def test_cells_are_compared_by_kind(column, old, new, is_same):
    assert same(column, old, new) == is_same


def test_a_column_less_and_one_more_are_changes():
    found = changes({"a": "1", "b": "2"}, {"b": "2", "c": ""})
    assert found == [("a", "1", "-"), ("c", "-", "")]
    assert shown("it", found).splitlines()[1].split() == ["it", "a", "1", "-"]


def test_what_is_written_is_what_is_expected(tmp_path, monkeypatch):
    monkeypatch.setattr(records, "EXPECTED", tmp_path)
    found = {"one": {"a, b": 'A "x" 1', "empty": ""}, "two": {"empty": "None"}}
    records.write("group", found)
    assert expected("group") == found
