"""The evidence for the promises, written into `docs/promises.md` between two markers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from benchmarks.faults.cases import KINDS, WHOLE, Case
from benchmarks.faults.promises import Outcome, broken, table
from benchmarks.timing import machine, packages
from experiments.studies.code_identity import code_version
from shared.errors import ConfigError

PAGE = "promises.md"
BEGIN, END = "<!-- evidence: begin -->", "<!-- evidence: end -->"


def with_evidence(page: str, text: str) -> str:
    """Return the page with its evidence replaced; raise `ConfigError` without the two markers."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ConfigError(f"docs: expected {BEGIN} and {END} in {PAGE}, got none; add them")
    return f"{before}{BEGIN}\n\n{text}\n\n{END}{after}"


def evidence(played: Mapping[Case, Outcome | None]) -> str:
    """Return the evidence as Markdown: cases, machine, versions, promises and faults."""
    seeds = ", ".join(str(seed) for seed in sorted({case.seed for case in played}))
    counts = []
    for kind in KINDS:
        of_kind = [outcome for case, outcome in played.items() if case.kind == kind]
        skipped = sum(outcome is not None and "skipped" in outcome for outcome in of_kind)
        counts.append(f"{len(of_kind) - skipped} of {WHOLE[kind]} {kind} cases")
        if skipped:
            counts[-1] += f" ({skipped} more skipped)"
    return "\n\n".join(
        [
            f"Played: {', '.join(counts)}. Seed {seeds}, code `{code_version()}`.",
            f"Machine: {machine()}. Versions: {packages()}.",
            "\n".join(table(played.items())),
            "\n".join(_by_fault(played)),
            *_skipped(played),
        ]
    )


def _by_fault(played: Mapping[Case, Outcome | None]) -> list[str]:
    lines = ["| | fault | cases | break a promise |", "|---|---|---:|---:|"]
    cases: Counter[tuple[str, str]] = Counter()
    faulty: Counter[tuple[str, str]] = Counter()
    for case, outcome in played.items():
        if outcome is None or "skipped" not in outcome:
            cases[case.kind, case.fault] += 1
            faulty[case.kind, case.fault] += bool(broken(case, outcome))
    for kind, fault in sorted(cases, key=lambda each: KINDS.index(each[0])):
        lines.append(f"| {kind} | {fault} | {cases[kind, fault]} | {faulty[kind, fault]} |")
    return lines


def _skipped(played: Mapping[Case, Outcome | None]) -> list[str]:
    reasons = Counter(
        (case.fault, outcome["skipped"])
        for case, outcome in played.items()
        if outcome is not None and "skipped" in outcome
    )
    lines = [f"* {fault}, {number} cases: {why}" for (fault, why), number in reasons.items()]
    return ["Skipped:\n\n" + "\n".join(lines)] if lines else []
