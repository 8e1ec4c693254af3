"""Tables, verdicts and claims from trials that nobody played."""

from __future__ import annotations

import pytest

from experiments.reproduction import verdict as judged
from experiments.reproduction.claims import claims
from experiments.reproduction.constant_delays import (
    TABLE_II,
    TABLE_III,
    delay_tables,
    delay_verdicts,
    tolerance_table,
)
from experiments.reproduction.discrepancy import by_cardinality, discrepancy_tables
from experiments.reproduction.five_g import five_g_tables, five_g_verdicts
from experiments.reproduction.layout import Table, in_columns, in_markdown, number
from experiments.reproduction.outcome import COM_ERROR, METRICS, VIOLATION, Outcome
from experiments.reproduction.published import published
from experiments.reproduction.results import Results
from experiments.reproduction.sections import STUDIES
from experiments.reproduction.verdict import Verdict
from tests.experiments.reproduction.made_up import finished, paperlike

INF = float("inf")


def outcome(*errors, violation=0.0):
    """Trials with these CoM errors [cm], seed by seed; None: fell."""
    return Outcome(
        tuple(
            {
                "network": "a",
                "seed": seed,
                "fell": error is None,
                "com_error_m": 99.0 if error is None else error / 100,
                "contact_violation_m_s2": violation,
                "error": None,
            }
            for seed, error in enumerate(errors)
        )
    )


def error_verdict(ours, paper, *, la, pr, **options):
    return judged.error_verdict(ours, paper, metric=COM_ERROR, la=la, pr=pr, **options)


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """Every study, with outcomes like the paper's."""
    out = tmp_path_factory.mktemp("complete")
    finished(out, *STUDIES, seeds=2)
    return Results(out)


def lines_of(table):
    return {tuple(line[:1]): line for line in table.lines}


def test_errors_are_means_over_the_trials_that_stood():
    some = outcome(1.0, None, 2.0)
    assert (some.played, some.stood) == (3, 2)
    assert some.error(COM_ERROR) == pytest.approx(1.5)
    assert outcome(None).error(COM_ERROR) is None


def test_trials_that_ended_with_an_error_are_not_played():
    rows = [*outcome(1.0).rows, {**outcome(2.0).rows[0], "error": "ValueError"}]
    assert Outcome.of(rows, network="a").played == 1
    assert Outcome.of(rows, network="b").played == 0


def test_two_controllers_are_compared_over_the_seeds_in_which_both_stood():
    la, pr = outcome(1.0, 9.0, None), outcome(2.0, None, 5.0)
    assert la.beside(pr, COM_ERROR) == (pytest.approx(1.0), pytest.approx(2.0))
    assert la.beside(outcome(None, None, 1.0), COM_ERROR) is None


def test_an_error_up_to_the_tolerance_is_as_good_as_the_papers():
    pr = outcome(9.0, 9.0)
    good, bad = outcome(1.054, 1.054), outcome(1.06, 1.06)
    assert error_verdict(good, 1.0, la=good, pr=pr) is Verdict.SAME_OR_BETTER
    assert error_verdict(bad, 1.0, la=bad, pr=pr) is Verdict.SAME_ORDERING
    assert error_verdict(bad, 1.0, la=bad, pr=outcome(1.0, 1.0)) is Verdict.DIFFERS


def test_a_fall_is_worse_than_any_error_of_the_paper():
    pr = la = outcome(0.1, None)
    assert error_verdict(pr, 5.0, la=outcome(0.1, 0.1), pr=pr) is Verdict.SAME_ORDERING
    assert error_verdict(la, 5.0, la=la, pr=outcome(0.2, 0.2)) is Verdict.DIFFERS
    half = {"paper_rate": 0.5}
    assert error_verdict(la, 5.0, la=la, pr=outcome(None, 1.0), **half) is Verdict.SAME_OR_BETTER


def test_where_the_papers_robot_fell_nothing_is_worse():
    fell = outcome(None, None)
    assert error_verdict(fell, INF, la=fell, pr=fell) is Verdict.SAME_OR_BETTER
    # But where it stood, and neither of ours does, there is no order left.
    assert error_verdict(fell, 1.0, la=fell, pr=fell) is Verdict.DIFFERS


def test_what_was_not_played_has_no_verdict():
    none, some = outcome(), outcome(1.0)
    assert error_verdict(none, 1.0, la=none, pr=some) is Verdict.UNKNOWN
    assert error_verdict(some, 1.0, la=some, pr=none) is Verdict.UNKNOWN
    assert judged.rate_verdict(none, 0.9, la=none, pr=some) is Verdict.UNKNOWN


def test_a_success_rate_is_judged_by_the_papers_and_then_by_the_order():
    la, pr = outcome(1.0, 1.0, None), outcome(1.0, None, None)
    assert judged.rate_verdict(la, 2 / 3, la=la, pr=pr) is Verdict.SAME_OR_BETTER
    assert judged.rate_verdict(la, 0.67, la=la, pr=pr) is Verdict.SAME_ORDERING
    assert judged.rate_verdict(pr, 0.5, la=pr, pr=la) is Verdict.DIFFERS


def test_every_delay_of_the_paper_has_a_number_for_each_controller_and_metric():
    for name, delays in (("table2", 7), ("table3", 4)):
        table = published()[name]
        assert len(table["delays_ms"]) == delays
        lengths = {len(table[metric][each]) for metric in METRICS for each in ("pr", "la")}
        assert lengths == {delays}
    for task, cardinalities in (("walk", 15), ("balance", 12)):
        assert {len(published()["table6"][task][metric]) for metric in METRICS} == {cardinalities}


def test_table_ii_has_the_papers_numbers_beside_ours(complete):
    stood, com, violation = delay_tables(complete, TABLE_II)
    assert lines_of(stood)[("50 ms",)][1:5] == ["0/2 (0–66 %)", "fell", "2/2 (34–100 %)", "stood"]
    assert lines_of(com)[("40 ms",)] == [
        "40 ms", "1.05", "2.21", "same or better", "1.04", "1.57", "same or better", "1.04", "1.00"
    ]  # fmt: skip
    assert lines_of(violation)[("50 ms",)][1:4] == ["∞", "∞", "same or better"]
    assert len(delay_verdicts(complete, TABLE_II)) == 2 * 2 * 7
    assert set(delay_verdicts(complete, TABLE_II)) == {Verdict.SAME_OR_BETTER}


def test_a_cell_says_how_many_stood_where_not_all_did(tmp_path):
    def half(trial):
        return None if trial.config.seed == 0 else (0.02, 0.1)

    finished(tmp_path, "table2", world=half, seeds=2)
    _, com, _ = delay_tables(Results(tmp_path), TABLE_II)
    assert lines_of(com)[("0 ms",)][1] == "2.00 (1/2 stood)"
    assert lines_of(com)[("0 ms",)][-1] == "–"


def test_table_iii_finds_its_delays_in_the_names_of_its_cells(complete):
    _, com, _ = delay_tables(complete, TABLE_III)
    assert [line[0] for line in com.lines] == ["0 ms", "3 ms", "5 ms", "25 ms"]
    assert lines_of(com)[("5 ms",)][1:4] == ["∞", "∞", "same or better"]


def test_tolerances_are_medians_beside_the_papers_longest_delay(complete):
    table = tolerance_table(complete, [TABLE_II, TABLE_III])
    found = {(line[0], line[1]): line[2:] for line in table.lines}
    assert found["Table II, balance", "PR"][:2] == ["2", "40"]
    assert found["Table II, balance", "LA"][3:] == ["100", "90", "same or better"]
    assert found["Table II, balance", "LC"][1] == "≥ 400"
    assert found["Table III, walk", "PR"][3:] == ["3", "3", "same or better"]
    assert tolerance_table(Results(complete.folder / "nowhere"), [TABLE_II]) is None


def test_table_iv_puts_shipped_and_generated_profiles_together_and_tells_them_apart(complete):
    together, shipped, generated = five_g_tables(complete)
    assert "2 shipped ns-3 and 2 generated" in together.title
    success = together.lines[3]
    assert success[:6] == [
        "factory",
        "walk",
        "success",
        "0 %, 0/4 (0–49 %)",
        "0 %",
        "same or better",
    ]
    assert success[6] == "100 %, 4/4 (51–100 %)"
    assert together.lines[4][3:6] == ["∞", "–", "–"]
    assert {len(shipped.lines), len(generated.lines)} == {12}
    assert shipped.lines[0][3] == "100 %, 2/2 (34–100 %)"
    # 8 rates, and 2 errors in each of the 6 cells where the paper has any.
    assert len(five_g_verdicts(complete)) == 8 + 2 * 6


def test_one_half_of_table_iv_is_a_table_too(tmp_path):
    finished(tmp_path, "table4", seeds=1)
    (table,) = five_g_tables(Results(tmp_path))
    assert "1 shipped ns-3 profiles" in table.title


def test_ticks_are_pooled_over_trials_of_different_length():
    prefix = "active_set_discrepancy."
    trials = ([100, 300], [0.01, 0.02]), ([100], [0.03]), ([0, 0, 2], [None, None, 1.0])
    rows = [
        {
            prefix + "ticks": ticks,
            prefix + "com_error_m": errors,
            prefix + "contact_violation_m_s2": errors,
        }
        for ticks, errors in trials
    ]
    pooled = by_cardinality(rows)
    assert [each.ticks for each in pooled] == [200, 300, 2]
    assert pooled[0].errors == pytest.approx({COM_ERROR: 2.0, VIOLATION: 0.02})
    assert pooled[2].errors == pytest.approx({COM_ERROR: 100.0, VIOLATION: 1.0})


def test_table_vi_orders_errors_by_that_without_discrepancy(complete):
    walk, balance = discrepancy_tables(complete)
    assert walk.lines[0][:5] == ["0", "1200", "1.00", "1.78", "same or better"]
    # In the paper, the walk's CoM error with 3 rows is larger than without; so it is here.
    assert walk.lines[3][2:5] == ["3.00", "1.90", "same ordering"]
    assert walk.lines[2][1:5] == ["–", "–", "1.88", "–"]
    # Too large without any row that differs: nothing to order it by.
    assert balance.lines[0][2:5] == ["1.00", "0.01", "differs"]
    assert len(walk.lines) == 15


def test_table_vi_leaves_out_who_fell(tmp_path):
    def half(trial):
        return None if trial.config.seed == 0 else (0.01, 0.0)

    finished(tmp_path, "table6", world=half, seeds=2)
    walk, _ = discrepancy_tables(Results(tmp_path))
    assert walk.lines[0][1] == "600"
    assert "of 1 trials" in walk.note


def test_all_claims_hold_in_a_world_like_the_papers(complete):
    assert [claim.sentence for claim in claims(complete) if claim.holds is not True] == [
        "Table V: the local controller takes less time than the QP"
    ]  # which is not played


@pytest.mark.parametrize(
    ("studies", "controller", "spoilt", "message"),
    [
        (["table2"], "la", (0.01, 9.0), "violation ≤ PR's at every delay; not so at 0, 10"),
        (["table3"], "la", (0.9, 0.0), "CoM error ≤ PR's at every delay; not so at 0, 3"),
        (["table2"], "la", None, "CoM error ≤ PR's at every delay; not so at 0, 10, 20, 30, 40"),
        (["tolerance-balance"], "la", None, "LA stands the paper's longest delay, 90 ms"),
        (["table3"], "pr", (0.01, 9.0), "PR always falls beyond 3 ms; stood 1/1 at 5 ms"),
        (["table4"], "la", None, "factory, walk: LA's success ≥ the paper's 85 %; 0 %, 0/1"),
        (["table4"], "pr", (0.01, 9.0), "building, walk: PR always falls; stood 100 %, 1/1"),
    ],
)  # fmt: skip
def test_a_claim_fails_where_the_rows_say_otherwise(tmp_path, studies, controller, spoilt, message):
    def world(trial):
        return spoilt if trial.config.controller == controller else paperlike(trial)

    finished(tmp_path, *studies, world=world, seeds=1)
    failed = [str(claim) for claim in claims(Results(tmp_path)) if claim.holds is False]
    assert any(message in claim and claim.startswith("does not hold: ") for claim in failed), failed


def test_without_rows_a_claim_neither_holds_nor_fails(tmp_path):
    assert {claim.holds for claim in claims(Results(tmp_path))} == {None}


def test_numbers_have_the_papers_digits_and_more_where_those_would_be_zero():
    assert [number(value) for value in (1.234, 0.0, 0.0012, 3e-14, INF, None)] == [
        "1.23", "0.00", "0.0012", "3e-14", "∞", "–"
    ]  # fmt: skip


def test_a_table_is_the_same_in_markdown_and_in_columns():
    table = Table("Title", ["a", "b"], [["1", "22"], ["333", "4"]], note="Note.")
    assert in_markdown(table).splitlines() == [
        "**Title**", "", "| a | b |", "| --- | --- |", "| 1 | 22 |", "| 333 | 4 |", "", "Note."
    ]  # fmt: skip
    assert in_columns(table).splitlines() == ["Title", "a    b", "1    22", "333  4", "Note."]
