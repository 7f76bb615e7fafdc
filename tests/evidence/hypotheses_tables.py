"""The tables of the study of hypotheses, before and after, from rows of plain cells."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy import stats

from tests.independent.faults import Fault
from tests.independent.rows import HARSH, Row, accused, named_first, named_or_rival

CHANGED = tuple(
    (Path(__file__).with_name("hypotheses_changed.md")).read_text(encoding="utf-8").rstrip().splitlines()
)
Coverage = Mapping[tuple[str, int], Mapping[str, Sequence[float]]]
# Damage, and p of the joint test, that no verdict may call usable.
DAMAGED, IMPROBABLE = 3.0, 1e-3
COMMANDS = ("check", "analyse")
OF_FAULTS = (
    "| fault | flights | check | analyse | or rival | same | accused | before | analyse | same | accused |",
    "|---" * 11 + "|",
)


class Study:
    """Rows of one version, with the faults that they are about."""

    def __init__(self, faults: Mapping[str, Fault], rows: Sequence[Row]) -> None:
        self.faults, self.rows = faults, rows

    def of(self, kind: str, *words: str) -> list[Row]:
        """Rows of a kind whose name begins with one of these words."""
        return [row for row in self.rows if row.kind == kind and (not words or row.name.startswith(words))]

    def named(self, rows: Iterable[Row], command: str) -> str:
        """In how many rows the fault is the first cause."""
        return share(named_first(self.faults[row.name], row, command) for row in rows)

    def wrongly(self, rows: Iterable[Row], command: str, severities: tuple[str, ...] = HARSH) -> str:
        """In how many rows something sound is accused."""
        return share(bool(accused(self.faults[row.name], row, command, severities)) for row in rows)


def share(decisions: Iterable[bool]) -> str:
    """Write how many of all."""
    listed = list(decisions)
    return f"{sum(listed)} of {len(listed)}" if listed else "-"


def page(faults: Mapping[str, Fault], before: Sequence[Row], after: Sequence[Row], covered: Coverage) -> str:
    """Write the page: what both versions said of the flights that both were shown."""
    keys = {(row.kind, row.name, row.seed) for row in after}
    common = [row for row in before if (row.kind, row.name, row.seed) in keys]
    old = {(row.kind, row.name, row.seed) for row in common}
    paired = [row for row in after if (row.kind, row.name, row.seed) in old]
    two = Study(faults, common), Study(faults, paired)
    whole = Study(faults, after)
    lines = [
        "# Causes named in flights with one fault, and without",
        "",
        f"{len(after)} flights, made by an independent simulator (`tests/independent`: numpy alone, with its",
        "own collinearity equations, distortion, rotations and noise) and written as block folders. `check`",
        f'and `analyse` judge each. "Before" is version dce6bc09 on {len(common)} of the same flights.',
        "A fault counts as named when it is the first cause, by its own name, with exactly the points or",
        "images concerned.",
        "",
        *CHANGED,
        "",
        "## Thirteen defects of version dce6bc09",
        "",
        "| | before | after |",
        "|---|---|---|",
        *defects(*two),
        "",
        "## Clean flights",
        "",
        "False alarms: flights with a grave or doubtful finding of `analyse`, of `check`, and of `check` for",
        'the direct method alone; then flights in which a note names a cause. "four" and "ten" count control',
        "points.",
        "",
        "| design | flights | analyse | check | of direct | notes |",
        "|---|---|---|---|---|---|",
        *(f"| {name} | {' | '.join(alarms(rows))} |" for name, rows in by_name(whole.of("clean"))),
        f"| **all** | {' | '.join(alarms(whole.of('clean')))} |",
        f"| all, before | {' | '.join(alarms(two[0].of('clean')))} |",
        f"| all, after, of the same flights | {' | '.join(alarms(two[1].of('clean')))} |",
        "",
        f"Grave or doubtful findings: {said(whole.of('clean'))}. Before: {said(two[0].of('clean'))}.",
        "",
        "Noise that differs from the stated sigmas:",
        "",
        "| design | flights | analyse | check | of direct | notes |",
        "|---|---|---|---|---|---|",
        *(f"| {name} | {' | '.join(alarms(rows))} |" for name, rows in by_name(whole.of("unusual"))),
        "",
        f"Grave or doubtful findings: {said(whole.of('unusual'))}. Before: {said(two[0].of('unusual'))}.",
        "",
        "## Faults one by one",
        "",
        "Faults of a practical size; then of twice the size that a test of this fault alone (0.1 %) detects",
        "in 80 % of cases, by normal equations of the simulator. Columns: named first by `check`; by",
        "`analyse`; by both first or as a rival, where the flight cannot separate them; the same first cause",
        "by both; something correct accused by either, unless by a reservation that names the fault as its",
        "rival.",
        "",
        *OF_FAULTS,
        *faults_table(whole, two[0], "fault"),
        "",
        "Twice the detectable size:",
        "",
        *OF_FAULTS,
        *faults_table(whole, two[0], "power"),
        "",
        "## Coverage",
        "",
        *coverage_table(covered),
        "",
        "## Joint test of the check points, clean flights",
        "",
        *uniform(whole.of("clean")),
        "",
        "## The same flight in other coordinates, names and cameras",
        "",
        *invariance(whole),
        "",
        "## Cost",
        "",
        "Processor time; before: analyse / adjust, check / adjust.",
        "",
        "| flight | adjust, s | analyse / adjust | check / adjust | adjustments (analyse, check) | before |",
        "|---|---|---|---|---|---|",
        *cost(whole, two[0]),
    ]
    return "\n".join(lines) + "\n"


def defects(old: Study, new: Study) -> list[str]:
    """Give one line or more for each defect: its measure, before and after."""

    def line(number: int, words: str, measure: Callable[[Study], str]) -> str:
        """Write a measure of both versions."""
        return f"| {number}. {words} | {measure(old)} | {measure(new)} |"

    shutters, strange = ("rolling 15 ms", "rolling 40 ms"), ("rolling 15 ms", "rolling 40 ms", "y scale 1e-3")
    pairs, swaps = ("two control points, 30",), ("two control points sw", "two near control points sw")
    gross = ("2 % of", "5 % of")
    alike = ("time", "one of", "one position", "c step 0.1")
    both_clean = "the same: something correct accused"
    return [
        line(1, f"damage above {DAMAGED:g} or joint p below 0.1 %, and called usable", size_unknown),
        line(1, "the same, and no finding names the fault, first or as rival", silently_usable),
        line(
            2,
            "rolling 15, 40 ms, y scale 1e-3: `check` accuses something correct",
            lambda s: s.wrongly(s.of("fault", *strange), "check"),
        ),
        line(
            2,
            "two control points 30 cm: both named by `check`",
            lambda s: s.named(s.of("fault", *pairs), "check"),
        ),
        line(2, both_clean, lambda s: s.wrongly(s.of("fault", *pairs), "check")),
        line(3, "two control points swapped: named", lambda s: s.named(s.of("fault", *swaps), "check")),
        line(4, "c held wrong, with control: named by `check`", lambda s: s.named(held(s), "check")),
        line(4, "the same, by `analyse`", lambda s: s.named(held(s), "analyse")),
        line(
            5,
            "one control point off: a typing error is reported",
            lambda s: share(is_slip(row) for row in s.of("fault", "one of")),
        ),
        line(
            5,
            "lever arm 5 cm right: exchanged axes are reported",
            lambda s: share("lever-arm-axes" in row.check for row in s.of("fault", "lever arm 5")),
        ),
        line(
            6,
            "positions with correlated errors: sigmas called too large",
            lambda s: share("sigmas-too-large" in r.check + r.analyse for r in s.of("unusual", "GNSS rem")),
        ),
        line(
            7,
            "clean: direct method doubtful",
            lambda s: share(of_direct(row) for row in s.of("clean")),
        ),
        line(
            8,
            "time, one control point, one position, c step 0.1 %: both commands name one first cause",
            lambda s: share(same_word(row) for row in s.of("fault", *alike)),
        ),
        line(
            9, "rolling 15, 40 ms: named by `analyse`", lambda s: s.named(s.of("fault", *shutters), "analyse")
        ),
        line(
            10,
            "heavy tails of the noise: an image is doubtful",
            lambda s: share(doubts_image(row) for row in s.of("unusual", "Student", "a tenth")),
        ),
        line(10, "gross rays: named by `check`", lambda s: s.named(s.of("fault", *gross), "check")),
        line(10, both_clean, lambda s: s.wrongly(s.of("fault", *gross), "check")),
        line(11, "clean: an axis is called biased", lambda s: share(bool(r.biased) for r in s.of("clean"))),
        line(
            12,
            "clean: `check` doubtful, not direct",
            lambda s: share(doubts(row) for row in s.of("clean")),
        ),
        "| 13. GNSS 5 cm low: 95 % claimed for c, without an error that all heights share | yes | no |",
    ]


def held(study: Study) -> list[Row]:
    """Flights whose c was held wrong, with control: without it nothing but check points can tell."""
    return [row for row in study.of("fault", "c held") if "no control" not in row.name]


def is_slip(row: Row) -> bool:
    """Whether a typing error is reported."""
    return any(one.cause == "slip" for one in row.told("check"))


def doubts_image(row: Row) -> bool:
    """Whether a single image is doubted."""
    return any(one.code == "image" and one.severity in HARSH for one in row.told("analyse"))


def doubts(row: Row) -> bool:
    """Whether `check` doubts anything, the direct method aside."""
    return any(one.severity in HARSH and one.subject != "direct" for one in row.told("check"))


def size_unknown(study: Study) -> str:
    """Count blocks that are harmed and called usable, of those that are harmed."""
    return share(r.check_verdict != "not-usable" for r in harmed(study))


def silently_usable(study: Study) -> str:
    """Count those of them of which no reservation says why they are harmed."""
    return share(
        r.check_verdict == "usable"
        or (r.check_verdict != "not-usable" and not named_or_rival(study.faults[r.name], r, "check"))
        for r in harmed(study)
    )


def harmed(study: Study) -> list[Row]:
    """Flights whose check points err by more than any verdict may pass over."""
    return [r for r in study.of("fault") if r.damage > DAMAGED or r.p < IMPROBABLE or r.sigma0_squared > 9.0]


def of_direct(row: Row) -> bool:
    """Whether the direct method alone raises a doubt."""
    return any(one.subject == "direct" and one.severity in HARSH for one in row.told("check"))


def same_word(row: Row) -> bool:
    """Whether both commands name one first cause, or none."""
    return len({tuple((one.code, one.subject) for one in row.causes(c)[:1]) for c in COMMANDS}) == 1


def alarms(rows: Sequence[Row]) -> tuple[str, ...]:
    """Give flights, and those with an alarm of each kind."""
    return (
        str(len(rows)),
        str(sum(any(one.severity in HARSH for one in row.told("analyse")) for row in rows)),
        str(sum(doubts(row) for row in rows)),
        str(sum(of_direct(row) for row in rows)),
        str(sum(any(one.severity not in HARSH for c in COMMANDS for one in row.causes(c)) for row in rows)),
    )  # fmt: skip


def said(rows: Iterable[Row]) -> str:
    """List what is called grave or doubtful, with the flights."""
    count: Counter[str] = Counter()
    for row in rows:
        count.update({f"{one.code} ({c})" for c in COMMANDS for one in row.told(c) if one.severity in HARSH})
    return (
        ", ".join(f"{words} {n}" for words, n in sorted(count.items(), key=lambda one: (-one[1], one[0])))
        or "nothing"
    )


def by_name(rows: Iterable[Row]) -> list[tuple[str, list[Row]]]:
    """Rows of each name, in the order of the first."""
    listed: dict[str, list[Row]] = {}
    for row in rows:
        listed.setdefault(row.name, []).append(row)
    return list(listed.items())


def faults_table(new: Study, old: Study, kind: str) -> list[str]:
    """Give a line a fault: flights and decisions of both versions."""
    before = dict(by_name(old.of(kind)))
    lines = []
    for name, rows in by_name(new.of(kind)):
        check, analyse, *others = _cells(new, rows)
        beside = share(
            all(named_or_rival(new.faults[row.name], row, command) for command in COMMANDS) for row in rows
        )
        cells = (check, analyse, beside, *others, *_cells(old, before.get(name, [])))
        lines.append(f"| {name} | {len(rows)} | {' | '.join(cells)} |")
    return lines


def _cells(study: Study, rows: list[Row]) -> tuple[str, ...]:
    wrong = (any(accused(study.faults[row.name], row, command) for command in COMMANDS) for row in rows)
    alike = share(same_word(row) for row in rows)
    return study.named(rows, "check"), study.named(rows, "analyse"), alike, share(wrong)


def coverage_table(covered: Coverage) -> list[str]:
    """Give root mean square errors in sigmas, and the share within 1.96 of them; asked are 93 to 97 %."""
    if not covered:
        return ["Not run."]
    designs = list(dict.fromkeys(design for design, _ in covered))
    names = list(dict.fromkeys(name for values in covered.values() for name in values))
    lines = [
        "Root mean square of true errors over standard deviations, and the share within 1.96 of them.",
        "",
        f"| | {' | '.join(f'{d}, {sum(k[0] == d for k in covered)} flights' for d in designs)} |",
        "|---" * (len(designs) + 1) + "|",
    ]
    for name in names:
        cells = []
        for design in designs:
            values = [v[name] for key, v in covered.items() if key[0] == design and name in v]
            square, inside = np.mean(values, axis=0) if values else (np.nan, np.nan)
            cells.append(f"{np.sqrt(square):.2f}, {inside:.1%}" if values else "-")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def uniform(rows: Sequence[Row]) -> list[str]:
    """Test p of the joint tests for being uniform (Kolmogorov and Smirnov)."""
    lines = ["| test | flights | p that it is uniform | below 5 % | below 1 % |", "|---|---|---|---|---|"]
    for words, key in (("d' C^-1 d", "p"), ("mean", "p_mean")):
        p = np.array([getattr(row, key) for row in rows])
        p = p[np.isfinite(p)]
        if len(p):
            test = stats.kstest(p, "uniform").pvalue
            lines.append(f"| {words} | {len(p)} | {test:.2f} | {np.sum(p < 0.05)} | {np.sum(p < 0.01)} |")
    return lines


def invariance(study: Study) -> list[str]:
    """Compare verdict and causes of each flight with those of it as it was flown."""
    as_flown = {(r.name.split(": ")[1], r.seed): r for r in study.of("placed", "as flown")}
    lines = ["| change | flights | same verdict | same causes |", "|---|---|---|---|"]
    for place in dict.fromkeys(r.name.split(": ")[0] for r in study.of("placed")):
        pairs = [(r, as_flown[key]) for r in study.of("placed", f"{place}:")
                 if (key := (r.name.split(": ")[1], r.seed)) in as_flown]  # fmt: skip
        verdicts = share(a.check_verdict == b.check_verdict for a, b in pairs)
        causes = share(all(_codes(a, c) == _codes(b, c) for c in COMMANDS) for a, b in pairs)
        lines.append(f"| {place} | {len(pairs)} | {verdicts} | {causes} |")
    return lines


def _codes(row: Row, command: str) -> list[str]:
    return list(dict.fromkeys(one.code for one in row.causes(command) if one.severity in HARSH))


def cost(new: Study, old: Study) -> list[str]:
    """Give processor time in adjustments' times."""

    def figures(row: Row) -> str:
        """Ratios of times."""
        return f"{row.analyse_s / row.adjust_s:.1f} | {row.check_s / row.adjust_s:.1f}"

    before = {row.name: row for row in old.of("cost")}
    return [
        f"| {r.name} | {r.adjust_s:.2f} | {figures(r)} | {r.analyse_adjustments}, {r.check_adjustments} | "
        + (figures(before[r.name]).replace(" | ", ", ") if r.name in before else "-")
        + " |"
        for r in new.of("cost")
    ]
