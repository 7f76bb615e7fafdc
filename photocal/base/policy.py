"""The policy: how sure is sure, how large is worth a word, how few are too few; each with its reason.

What decides what a person is told stands here and nowhere else. Constants that only steer an algorithm
(steps, rounds, sizes of buffers) stand beside it.
"""

# --- How sure ---------------------------------------------------------------------------------------------

# Probability that a test of one observation, one point or one fault alarms although nothing is wrong
# (Baarda 1968: alpha 0.1 %, beta 80 %). Families of such tests divide it by their number.
SIGNIFICANCE = 0.001
POWER = 0.80
# Probability that one family of the analysis (all image axes, all strips, all fields of a lens) alarms on a
# clean block: ten families make one false finding in twenty calibrations.
FAMILY_SIGNIFICANCE = 0.005
# Significance of a camera's parameter, where nobody asks for another: one that is kept in vain costs less
# than one that is left out.
PARAMETER_SIGNIFICANCE = 0.10
# A head that stayed is said to have moved, a calibration that repeats to differ, in one comparison of
# twenty.
REPEAT_SIGNIFICANCE = 0.05
# Probability of intervals, ellipses, predicted errors and the global test, and the standard deviations of a
# normal variable that it stands for; those of `SIGNIFICANCE`, two-sided.
CONFIDENCE = 0.95
TIMES_95 = 1.959964
TIMES_999 = 3.290527
# 1 / the 0.75 quantile of the normal distribution: the median of absolute deviations times this estimates
# the standard deviation of normal data (Hoehle and Hoehle 2009).
MAD_TO_SIGMA = 1.482602218505602

# --- One cause or another ---------------------------------------------------------------------------------

# Falls of v'Pv, or twice the logarithm of likelihoods, that differ by no more do not tell two causes apart
# (Raftery 1995: beyond 10 evidence is very strong).
AS_GOOD = 10.0
# What explains this share of the gain of a cause is another name for the same error.
SAME_GAIN = 0.95
# What the condensed equations tell to be below this share of its limit, or of the best cause's gain, is not
# adjusted to confirm it: they neglect no more than second order.
SCREENED = 0.5
# A cause that gains less than this share of the gravest one's gain may be what the linear model leaves of
# it.
MINOR_GAIN = 0.1
# A cause that makes a group of observations agree explains this share of what its v'Pv is too large by: then
# its standard deviations are not blamed. Of all that is too large, a cause that is named explains this share
# where the model with it does not pass: less is "not explained by what was looked for".
EXPLAINED_GROUP, EXPLAINED = 0.8, 0.9
# Share of the rays' v'Pv that neighbours on their images may have in common, and standard deviations that
# residuals may be larger than stated, as a factor, before something is left to explain (limits of
# equivalence).
PATTERN, EQUIVALENT = 0.1, 1.05
# Models of a lens are alike when Akaike's criterion differs by no more (Burnham and Anderson 2002, 2.6).
ALIKE_MODELS = 4.0

# --- How large is worth a word ----------------------------------------------------------------------------

# An error on the ground is harmful from this share of the root mean square error that was asked for on: with
# it and as much of chance the target is still met. Where nothing was asked for, from one pixel on.
HARM_SHARE = 0.5
# Standard deviations that are wrong by a smaller share are no finding, however sure it is; beyond the
# second they are no longer small.
WRONG_SIGMA = 0.1
BADLY_WRONG_SIGMA = 1.2
# An axis, a camera or an image is listed from this ratio of scatter on, and not called small from the
# second.
WORTH_A_LINE = 1.05
SMALL_RATIO = 1.25
# An effect is small below half a pixel and two standard deviations of c, or where it moves heights by less
# than 1 cm in 100 m, or object points by less than this share of their standard deviations.
SMALL_PX = 0.5
SMALL_SIGMAS = 2.0
SMALL_SHARE = 1e-4
SMALL_MOVE = 1.0
# An image's own scale or principal point is listed when it moves a ray beyond the noise of single ones.
VISIBLE_SIGMAS = 2.5
# A jackknife error this many times the formal one; a parameter this many of its prior sigmas away.
UNSTABLE = 3.0
CONTRADICTED = 4.0
# Errors at ground points that are this many times as large as predicted, or as small.
WORTH_A_WORD = 1.5
# Errors of GNSS stay alike for minutes: a shift within the 95 % that are stated of each position, in its
# standard deviations, is what was stated, unless it moves c beyond the 95 % that are stated of it.
STATED = 2.0
# A principal distance that differs by a smaller share is no other camera, zoom or focus: warmth and
# correlated tie points do that, too. A smaller shift is no mistake of a person, m.
OTHER_C = 5e-4
OTHER_PLACE_M = 0.03
# A slip (digits swapped, a metre) explains a wrong coordinate when it comes this near, in standard
# deviations.
SLIP_SIGMAS = 4.0
# A position with a larger sigma is one of code: its errors are metres and last for minutes.
COARSE_M = 0.5
# Standard uncertainty of the height that all GNSS positions of a flight share where nobody states it, m: base
# coordinates, antenna heights and geoid of a careful survey.
COMMON_HEIGHT_M = 0.02
# The largest coefficient of refraction that is taken for one: it is 0.17 in the standard atmosphere.
REFRACTION = 0.5
# A correlation of parameters that is called strong.
STRONG_CORRELATION = 0.8
# A calibration of a usual network gives c to better than a thousandth; five times that share is weak.
WEAK_C = 0.005
# Sine of phi from which on omega and kappa of a photo are one angle (82 degrees).
ONE_ANGLE = 0.99

# --- How few are too few ----------------------------------------------------------------------------------

# With less redundancy a group of observations says nothing about its standard deviations.
FEWEST_REDUNDANT = 2.0
# With fewer control points a contradiction cannot be laid at the door of one of them.
FEWEST_CONTROL_TO_BLAME = 4
# Check points that stand out one by one are mistakes of single points up to this share of all: of more nobody
# knows which ones are wrong, they or the block.
SINGLE_POINTS = 1.0 / 3.0
# So many control points orient a block; a block that has them and cannot be oriented has something wrong.
FEWEST_CONTROL = 3
# Three points orient an image in up to four ways, and nothing checks them.
FEWEST_RAYS_OF_IMAGE = 4
# Below this number of check points the standard deviation is known to worse than a quarter of itself (95
# %).
SMALL_SAMPLE = 30
# Below this number a deviation cannot be told from the spread that it makes itself.
SMALLEST_SAMPLE = 5
# Coordinates of an image that is tested for a scale and a principal point of its own.
FEWEST_COORDINATES_OF_IMAGE = 12
# Share of a residual below which almost nothing checks it: its part of an error is not known.
LEAST_CHECKED = 0.05
