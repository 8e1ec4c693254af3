"""Table V: computation times of the full QP and the local controller, beside the paper's."""

from __future__ import annotations

from experiments.reproduction.compute_times import LOCAL, QP, ComputeTimes
from experiments.reproduction.layout import Table
from experiments.reproduction.published import published
from experiments.reproduction.results import Results
from experiments.reproduction.verdict import Verdict, verdict, within

_NAMES = {"qp": QP, "local": LOCAL["la"]}
_IN_WORDS = {"qp": "full QP", "local": "local controller (LA)"}
_KINDS = ("mean", "worst")


def computation_tables(results: Results) -> list[Table]:
    """Three tables: times beside the paper's, all times, messages; [] without a measurement."""
    times = results.compute_times
    if times is None:
        return []
    lines = []
    for clock, factor in _clocks(times).items():
        for which, words in _IN_WORDS.items():
            line = [clock, words]
            for kind in _KINDS:
                ours, paper = _ms(times, which, kind, factor), _paper(clock, which, kind)
                judged = _verdict(times, clock, which, kind)
                line += [f"{ours:.2f}", f"{paper:.2f}", judged.value]
            line.append(f"{factor * times.time(_NAMES[which]).worst_ms:.2f}")
            lines.append(line)
    columns = ["the paper's core", "", "mean [ms]", "paper", "verdict"]
    columns += ["worst, undisturbed [ms]", "paper", "verdict", "worst [ms]"]
    return [
        Table("Table V: beside the paper", columns, lines, note=_note(times)),
        Table("Everything measured", times.columns, times.rows(), note=times.note),
        Table("Messages", times.message_columns, times.message_rows()),
    ]


def computation_verdicts(results: Results) -> list[Verdict]:
    """Verdicts on all numbers of the paper's table."""
    times = results.compute_times
    if times is None:
        return []
    return [
        _verdict(times, clock, which, kind)
        for clock in _clocks(times)
        for which in _NAMES
        for kind in _KINDS
    ]


def local_is_cheaper(results: Results) -> tuple[bool | None, str]:
    """Return whether LA's controller takes less time than the QP, and the times in words.

    Compared are the mean and the worst undisturbed tick. (None, "") without a measurement.
    """
    times = results.compute_times
    if times is None:
        return None, ""
    pairs = {kind: [_ms(times, which, kind, 1.0) for which in _NAMES] for kind in _KINDS}
    text = [f"{kind} {local:.2f} of {qp:.2f} ms" for kind, (qp, local) in pairs.items()]
    return all(local < qp for qp, local in pairs.values()), ", ".join(text)


def _clocks(times: ComputeTimes) -> dict[str, float]:
    """The paper's two clocks, and for each the factor that multiplies our times."""
    return dict(zip(published()["table5"], (1.0, times.scale), strict=True))


def _ms(times: ComputeTimes, which: str, kind: str, factor: float) -> float:
    measured = times.time(_NAMES[which])
    return factor * (measured.mean_ms if kind == "mean" else measured.undisturbed_worst_ms)


def _paper(clock: str, which: str, kind: str) -> float:
    return float(published()["table5"][clock][which][kind])


def _verdict(times: ComputeTimes, clock: str, which: str, kind: str) -> Verdict:
    """The verdict on one time; the ordering is that the local controller takes less than the QP."""
    ours = _ms(times, which, kind, _clocks(times)[clock])
    local, qp = (_ms(times, name, kind, 1.0) for name in ("local", "qp"))
    return verdict(within(ours, _paper(clock, which, kind)), local < qp)


def _note(times: ComputeTimes) -> str:
    return (
        f"The paper's core is a Xeon at these clocks. Our core is {times.cpu}. Our times stand "
        f"unscaled beside the first clock and × {times.scale:g} beside the second. The verdict "
        "uses the worst undisturbed tick, because other work of the machine causes the worst tick "
        "of all."
    )
