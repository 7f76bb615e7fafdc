"""The analysis of published parameters for a person at the terminal and for programs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from photocal.analysis.components import Components
from photocal.analysis.published import PublishedSet
from photocal.findings.catalogue import Catalogue

SCHEMA = "photocal.published/1"


def published_text(sets: tuple[PublishedSet, ...], say: Catalogue) -> str:
    """Write tests, strong correlations and principal components of every set."""
    return "\n\n".join("\n".join(_lines(one, say)) for one in sets)


def published_record(sets: tuple[PublishedSet, ...]) -> dict[str, Any]:
    """Give the same as plain values, ready for JSON; what is not known is null."""
    return {"schema": SCHEMA, "sets": [_record(one) for one in sets]}


def _lines(one: PublishedSet, say: Catalogue) -> list[str]:
    lines = [say("published.set", name=one.name)] if one.name else []
    for test in one.tests:
        verdict = say("console.is_significant" if test.significant else "console.not_significant")
        kind, critical = say(f"test.{test.kind}"), f"{test.critical:.2f}"
        lines.append(
            f"  {' '.join(test.parameters):<12}{kind:<11} F {test.statistic:>10.4g} / {critical}  {verdict}"
        )
    lines += [
        f"  {pair.first}-{pair.second} {pair.value:+.3f}: {say(f'cause.{pair.cause}')}"
        for pair in one.correlations
    ]
    return lines if one.components is None else [*lines, *_table(one.components, say)]


def _table(components: Components, say: Catalogue) -> list[str]:
    """Eigenvalues, their shares, and the correlation of each parameter with each component (MCCP)."""
    rows: list[tuple[str, np.ndarray[Any, Any], str]] = [
        (say("published.eigenvalue"), components.eigenvalues, ".4f"),
        (say("published.percent"), components.percent, ".2f"),
        (say("published.cumulative"), components.cumulative_percent, ".2f"),
        *((name, row, ".2f") for name, row in zip(components.names, components.loadings, strict=True)),
    ]
    width = max(len(label) for label, _, _ in rows)
    head = "".join(f"{f'Y{k}':>9}" for k in range(1, len(components.names) + 1))
    return [f"  {'':<{width}}{head}"] + [
        f"  {label:<{width}}{''.join(f'{value:>9{form}}' for value in values.tolist())}"
        for label, values, form in rows
    ]


def _record(one: PublishedSet) -> dict[str, Any]:
    freedom = one.degrees_of_freedom
    components = one.components
    return {
        "set": one.name or None,
        "parameters": list(one.estimates.names),
        "degrees_of_freedom": freedom if math.isfinite(freedom) else None,
        "tests": [{**vars(test), "parameters": list(test.parameters)} for test in one.tests],
        "correlations": [dict(vars(pair)) for pair in one.correlations],
        "components": None
        if components is None
        else {
            "eigenvalues": components.eigenvalues.tolist(),
            "percent": components.percent.tolist(),
            "cumulative_percent": components.cumulative_percent.tolist(),
            "loadings": components.loadings.tolist(),
        },
    }
