import pytest
from records import PARTS, changes, expected, run, shown, table


@pytest.mark.parametrize(
    "record", [each for each in table() if each.group in PARTS["structures"]], ids=lambda record: record.name
)
def test_records_are_as_written(record):
    found = changes(expected(record.group)[record.name], run(record))
    assert not found, "\n" + shown(record.name, found)
