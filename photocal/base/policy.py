"""The policy: how sure is sure, how large is worth a word, how few are too few; each with its reason.

Every threshold that decides what is reported is here and nowhere else. Constants that only steer an
algorithm (steps, rounds, sizes of buffers) stay with it.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Policy:
    """The thresholds that decide what is reported."""

    # --- How sure -------------------------------------------------------------------------------------------

    # Probability that a test of one observation, one point or one fault alarms although nothing is wrong
    # (Baarda 1968: alpha 0.1 %, beta 80 %). Families of such tests divide it by their number.
    significance: float = 0.001
    power: float = 0.80
    # Probability that one family of the analysis (all image axes, all strips, all fields of a lens) alarms on
    # a clean block: ten families make one false finding in twenty calibrations.
    family_significance: float = 0.005
    # Significance of a camera's parameter, where nobody asks for another: one that is kept in vain costs less
    # than one that is left out.
    parameter_significance: float = 0.10
    # A head that stayed is said to have moved, a calibration that repeats to differ, in one comparison of
    # twenty.
    repeat_significance: float = 0.05
    # Probability of intervals, ellipses, predicted errors and the global test, and the standard deviations of
    # a normal variable that it stands for; those of `significance`, two-sided.
    confidence: float = 0.95
    times_95: float = 1.959964
    times_999: float = 3.290527
    # 1 / the 0.75 quantile of the normal distribution: the median of absolute deviations times this estimates
    # the standard deviation of normal data (Hoehle and Hoehle 2009).
    mad_to_sigma: float = 1.482602218505602

    # --- One cause or another -------------------------------------------------------------------------------

    # Falls of v'Pv, or twice the logarithm of likelihoods, that differ by no more do not tell two causes
    # apart (Raftery 1995: beyond 10 evidence is very strong).
    as_good: float = 10.0
    # What explains this share of the gain of a cause is another name for the same error.
    same_gain: float = 0.95
    # What the condensed equations tell to be below this share of its limit, or of the best cause's gain, is
    # not adjusted to confirm it: they neglect no more than second order.
    screened: float = 0.5
    # A cause that gains less than this share of the gravest one's gain may be what the linear model leaves of
    # it.
    minor_gain: float = 0.1
    # A cause that makes a group of observations agree explains this share of what its v'Pv is too large by:
    # then its standard deviations are not blamed. Of all that is too large, a cause that is named explains
    # this share where the model with it does not pass: less is "not explained by what was looked for".
    explained_group: float = 0.8
    explained: float = 0.9
    # Share of the rays' v'Pv that neighbours on their images may have in common, and standard deviations that
    # residuals may be larger than stated, as a factor, before something is left to explain (limits of
    # equivalence).
    pattern: float = 0.1
    equivalent: float = 1.05
    # Models of a lens are alike when Akaike's criterion differs by no more (Burnham and Anderson 2002, 2.6).
    alike_models: float = 4.0

    # --- How large is worth a word --------------------------------------------------------------------------

    # An error on the ground is harmful from this share of the root mean square error that was asked for on:
    # with it and as much of chance the target is still met. Where nothing was asked for, from one pixel on.
    harm_share: float = 0.5
    # Standard deviations that are wrong by a smaller share are no finding, however sure it is; beyond the
    # second they are no longer small.
    wrong_sigma: float = 0.1
    badly_wrong_sigma: float = 1.2
    # An axis, a camera or an image is listed from this ratio of scatter on, and not called small from the
    # second.
    worth_a_line: float = 1.05
    small_ratio: float = 1.25
    # An effect is small below half a pixel and two standard deviations of c, or where it moves heights by
    # less than 1 cm in 100 m, or object points by less than this share of their standard deviations.
    small_px: float = 0.5
    small_sigmas: float = 2.0
    small_share: float = 1e-4
    small_move: float = 1.0
    # An image's own scale or principal point is listed when it moves a ray beyond the noise of single ones.
    visible_sigmas: float = 2.5
    # A jackknife error this many times the formal one; a parameter this many of its prior sigmas away.
    unstable: float = 3.0
    contradicted: float = 4.0
    # Errors at ground points that are this many times as large as predicted, or as small.
    worth_a_word: float = 1.5
    # Errors of GNSS stay alike for minutes: a shift within the 95 % that are stated of each position, in its
    # standard deviations, is what was stated, unless it moves c beyond the 95 % that are stated of it.
    stated: float = 2.0
    # A principal distance that differs by a smaller share is no other camera, zoom or focus: warmth and
    # correlated tie points do that, too. A smaller shift is no mistake of a person, m.
    other_c: float = 5e-4
    other_place_m: float = 0.03
    # A slip (digits swapped, a metre) explains a wrong coordinate when it comes this near, in standard
    # deviations.
    slip_sigmas: float = 4.0
    # A position with a larger sigma is one of code: its errors are metres and last for minutes.
    coarse_m: float = 0.5
    # Standard uncertainty of the height that all GNSS positions of a flight share where nobody states it, m:
    # base coordinates, antenna heights and geoid of a careful survey.
    common_height_m: float = 0.02
    # The largest coefficient of refraction that is taken for one: it is 0.17 in the standard atmosphere.
    refraction: float = 0.5
    # Rows of a frame are read in no less, s: published electronic read-outs begin at 8 ms, curtains of
    # focal-plane shutters take 2 to 4 ms. What looks like less is more probably another scale of y.
    least_readout_s: float = 0.002
    # A correlation of parameters that is called strong.
    strong_correlation: float = 0.8
    # A calibration of a usual network gives c to better than a thousandth; five times that share is weak.
    weak_c: float = 0.005
    # Sine of phi from which on omega and kappa of a photo are one angle (82 degrees).
    one_angle: float = 0.99

    # --- How few are too few --------------------------------------------------------------------------------

    # With less redundancy a group of observations says nothing about its standard deviations.
    fewest_redundant: float = 2.0
    # With fewer control points a contradiction cannot be laid at the door of one of them.
    fewest_control_to_blame: int = 4
    # Check points that stand out one by one are mistakes of single points up to this share of all: of more
    # nobody knows which ones are wrong, they or the block.
    single_points: float = 1.0 / 3.0
    # So many control points orient a block; a block that has them and cannot be oriented has something wrong.
    fewest_control: int = 3
    # Three points orient an image in up to four ways, and nothing checks them.
    fewest_rays_of_image: int = 4
    # Below this number of check points the standard deviation is known to worse than a quarter of itself (95
    # %).
    small_sample: int = 30
    # Below this number a deviation cannot be separated from the spread that it causes itself.
    smallest_sample: int = 5
    # Coordinates of an image that is tested for a scale and a principal point of its own.
    fewest_coordinates_of_image: int = 12
    # Share of a residual below which almost nothing checks it: its part of an error is not known.
    least_checked: float = 0.05


policy = Policy()
