"""What an adjustment says of laser distances that are observations: of all of them, and of single ones."""

import numpy as np
from scipy import special

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.lasers import OFFSET
from photocal.adjustment.reliability import UNCHECKED
from photocal.base.policy import policy
from photocal.findings.finding import Finding

CODE = "laser-offset"


def of_lasers(fitted: AdjustedNetwork) -> tuple[Finding, ...]:
    """Test the offset of all laser distances against the rest of the block, and each distance by its w.

    The offset is observed as zero. With r its redundancy number, an error of that observation, which is one
    of all distances, is found as v / r with the standard deviation sigma / sqrt(r) (Baarda 1968).
    """
    network, solution = fitted.network, fitted.solution
    lasers = network.lasers
    if not len(lasers.image):
        return ()
    first = len(network.mounting.values)
    offset = float(solution.state.common[first + OFFSET])
    variance = float(solution.common_covariance[first + OFFSET, first + OFFSET])
    stated = lasers.common_sigma[OFFSET]
    bias, sigma = offset, float(np.sqrt(variance))
    tested = 0.0 < stated < np.inf
    if tested:
        checked = max(1.0 - variance / stated**2, UNCHECKED)
        bias, sigma = offset / checked, stated / float(np.sqrt(checked))
    v, r = solution.laser_residuals, solution.laser_redundancy
    w = np.abs(v) / (lasers.sigma * np.sqrt(np.maximum(r, UNCHECKED)))
    # All of them together name a good one no more often than a single test does.
    limit = -float(special.ndtri(policy.significance / (2 * len(w))))
    off = np.flatnonzero((w > limit) & (r > UNCHECKED))
    redundancy = float(r.sum())
    factor = float(np.sqrt(np.sum((v / lasers.sigma) ** 2) / redundancy)) if redundancy > 0.0 else np.nan
    figures = {
        "n": float(len(w)), "bias_m": bias, "sigma_m": sigma, "stated_m": float(stated), "factor": factor,
        "offset_m": offset, "redundancy": redundancy, "off": float(len(off)),
        "images": tuple(network.image_names[i] for i in lasers.image[off[np.argsort(-w[off])]]),
    }  # fmt: skip
    refuted = tested and abs(bias) > policy.times_999 * sigma
    clauses = ("laser-refuted",) * refuted + ("laser-off",) * bool(len(off))
    return (Finding(CODE, "doubtful" if clauses else "note", figures=figures, clauses=clauses),)
