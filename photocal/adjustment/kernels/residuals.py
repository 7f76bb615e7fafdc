"""Residuals of all rays."""

from photocal.adjustment.kernels.data import Design, Values, width
from photocal.adjustment.kernels.ray import ray_rows
from photocal.base.arrays import Floats
from photocal.base.compiled import compiled, each_piece
from photocal.geometry.lens import Scratch, scratch


@compiled
def evaluate_piece(
    design: Design, values: Values, piece: int, room: Scratch, residuals: Floats, depth: Floats
) -> None:
    """Residuals of one piece's points, see `evaluate`."""
    for j in range(design.spans[piece], design.spans[piece + 1]):
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            residuals[r, 0], residuals[r, 1] = ray_rows(design, values, r, design.ray_image[r], j, room)
            depth[r] = room.depth[0]


def evaluate(design: Design, values: Values, residuals: Floats, depth: Floats) -> None:
    """Residuals of all rays.

    residuals (rays, 2): receives computed minus measured.
    depth (rays,): receives how far each point lies in front of the camera, m.
    """

    def work(piece: int) -> None:
        """Residuals of one piece; pieces run side by side."""
        evaluate_piece(design, values, piece, scratch(width(design)), residuals, depth)

    each_piece(len(design.pieces) - 1, work)
