"""Standard deviations of positions and attitudes that are wrong by a factor, rather than by a cause."""

from __future__ import annotations

from dataclasses import replace

from photocal.adjustment.adjust import adjust
from photocal.adjustment.groups import FEWEST, GroupTest, tested
from photocal.adjustment.solution import Solution
from photocal.block.model import Block
from photocal.block.network import assemble

_SIGNIFICANCE = 0.001
# Standard deviations that are wrong by no more are no finding.
_NO_FINDING = 0.1
# They are settled when they change by a smaller share; it takes no more adjustments.
_SETTLED, _SETTLING = 0.02, 12


def wrong_sigma(first: Solution, cause: float) -> GroupTest | None:
    """Choose the group whose stated sigmas are wrong, rather than a cause.

    A factor is one unknown, and gains likelihood where all residuals of a group are too large or too small;
    an error competes with it (Schwarz 1978). Too small residuals no error explains.
    """
    groups = (tested(group) for group in first.groups if group.name in ("position", "attitude"))
    wrong = [
        one
        for one in groups
        if one.redundancy >= FEWEST
        and one.p_value < _SIGNIFICANCE
        and abs(one.factor - 1.0) > _NO_FINDING
        and (one.factor < 1.0 or one.gain > cause)
    ]
    return max(wrong, key=lambda one: one.gain, default=None)


def with_agreeing(block: Block, one: GroupTest) -> tuple[Block, GroupTest]:
    """Give positions or attitudes the standard deviations that agree (Foerstner 1979), and their factor."""
    total = 1.0
    for _ in range(_SETTLING):
        total *= one.factor
        if one.name == "position":
            own = replace(block.positions, covariance=block.positions.covariance * one.factor**2)
            block = replace(block, positions=own)
        else:
            turns = replace(block.attitudes, covariance=block.attitudes.covariance * one.factor**2)
            block = replace(block, attitudes=turns)
        groups = adjust(assemble(block).network).groups
        one = tested(next(group for group in groups if group.name == one.name))
        if abs(one.factor - 1.0) < _SETTLED:
            break
    limits = total * one.lower / one.factor, total * one.upper / one.factor
    return block, replace(one, factor=total, lower=limits[0], upper=limits[1])
