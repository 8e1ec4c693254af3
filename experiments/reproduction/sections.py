"""The parts of the paper's evaluation, by their names in `run`, cheapest first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from experiments.reproduction.computation import computation_tables, computation_verdicts
from experiments.reproduction.constant_delays import (
    TABLE_II,
    TABLE_II_RIGID,
    TABLE_III,
    DelayTable,
    delay_tables,
    delay_verdicts,
    tolerance_table,
)
from experiments.reproduction.discrepancy import discrepancy_tables, discrepancy_verdicts
from experiments.reproduction.five_g import five_g_tables, five_g_verdicts
from experiments.reproduction.layout import Table
from experiments.reproduction.results import Results
from experiments.reproduction.verdict import Verdict


@dataclass(frozen=True)
class Section:
    """A table of the paper: the studies that it needs, its tables of text, and its verdicts."""

    name: str
    title: str
    studies: tuple[str, ...]
    tables: Callable[[Results], list[Table]]
    verdicts: Callable[[Results], list[Verdict]]


def _delays(*tables: DelayTable) -> Callable[[Results], list[Table]]:
    def made(results: Results) -> list[Table]:
        tolerance = tolerance_table(results, tables)
        by_delay = [made for table in tables for made in delay_tables(results, table)]
        return [*by_delay, *([] if tolerance is None else [tolerance])]

    return made


def _delay_verdicts(*tables: DelayTable) -> Callable[[Results], list[Verdict]]:
    return lambda results: [each for table in tables for each in delay_verdicts(results, table)]


_OF_TABLE_II = (TABLE_II, TABLE_II_RIGID)

SECTIONS = {
    section.name: section
    for section in (
        Section(
            "table5",
            "Table V: computation times",
            (),
            computation_tables,
            computation_verdicts,
        ),
        Section(
            "table6",
            "Table VI: errors by the discrepancy of the active set",
            ("table6",),
            discrepancy_tables,
            discrepancy_verdicts,
        ),
        Section(
            "table3",
            "Table III: the walk over constant delays",
            ("reference", "table3", "tolerance-walk"),
            _delays(TABLE_III),
            _delay_verdicts(TABLE_III),
        ),
        Section(
            "table2",
            "Table II: balance over constant delays",
            ("reference", "table2", "table2-rigid", "tolerance-balance", "tolerance-balance-rigid"),
            _delays(*_OF_TABLE_II),
            _delay_verdicts(*_OF_TABLE_II),
        ),
        Section(
            "table4",
            "Table IV: 5G links",
            ("reference", "table4", "table4-generated"),
            five_g_tables,
            five_g_verdicts,
        ),
    )
}

STUDIES = sorted({study for section in SECTIONS.values() for study in section.studies})
