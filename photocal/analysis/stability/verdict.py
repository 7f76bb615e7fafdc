"""What the figures of a comparison mean: thresholds, printed figures to follow, sentences."""

from __future__ import annotations

from dataclasses import dataclass

from photocal.analysis.stability.comparison import Figure, Pair


@dataclass(frozen=True)
class Printed:
    """A figure printed elsewhere for a pair of these calibrations.

    method, definition: how it was computed, as in `Method`.
    first, second: the calibrations.
    value_px, tolerance_px: the printed figure and how far the recomputed one may be from it.
    """

    method: str
    definition: str
    first: str
    second: str
    value_px: float
    tolerance_px: float


@dataclass(frozen=True)
class Followed:
    """Whether a printed figure follows from the parameters.

    printed: the printed figure.
    computed_px: the figure from the parameters.
    """

    printed: Printed
    computed_px: float

    @property
    def follows(self) -> bool:
        """Whether both agree within the tolerance."""
        return abs(self.computed_px - self.printed.value_px) <= self.printed.tolerance_px


def follow(printed: tuple[Printed, ...], pairs: tuple[Pair, ...]) -> tuple[Followed, ...]:
    """Set printed figures against those of the comparison."""
    computed = {
        (figure.method, figure.definition, pair.first, pair.second): figure.value_px
        for pair in pairs
        for figure in pair.figures
    }
    keys = [(one.method, one.definition, one.first, one.second) for one in printed]
    return tuple(
        Followed(one, computed[key]) for one, key in zip(printed, keys, strict=True) if key in computed
    )


def likeness(figure: Figure, thresholds_px: tuple[float, ...]) -> float | None:
    """Give the tightest threshold that a figure keeps.

    thresholds_px: thresholds, px.
    returns: the threshold; None when the figure exceeds them all.
    """
    return min((limit for limit in thresholds_px if figure.value_px <= limit), default=None)


def sentences(
    pairs: tuple[Pair, ...], thresholds_px: tuple[float, ...], followed: tuple[Followed, ...]
) -> tuple[str, ...]:
    """Put a comparison into words.

    thresholds_px: thresholds, px.
    """
    loosest = max(thresholds_px)
    said = []
    for k, kind in enumerate(pairs[0].figures):
        figures = [pair.figures[k] for pair in pairs]
        alike = sum(figure.value_px <= loosest for figure in figures)
        beyond = [figure.different for figure in figures if figure.different is not None]
        noise = f"; {sum(beyond)} of {len(beyond)} differ beyond their noise" if beyond else ""
        worst = max(range(len(pairs)), key=lambda i: figures[i].value_px)
        said.append(
            f"{kind.method} ({kind.definition}): {alike} of {len(pairs)} pairs within {loosest:g} px, "
            f"largest {figures[worst].value_px:.2f} px ({pairs[worst].first}-{pairs[worst].second}){noise}."
        )
    said += [
        f"Pair {one.printed.first}-{one.printed.second}: the printed {one.printed.method} "
        f"({one.printed.definition}) of {one.printed.value_px:g} px does not follow from its parameters, "
        f"which give {one.computed_px:.2f} px."
        for one in followed
        if not one.follows
    ]
    return tuple(said)
