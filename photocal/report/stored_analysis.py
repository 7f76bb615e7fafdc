"""What a certificate says of an analysis, read back from `analysis.json`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from drivers.errors import InputMalformedError
from photocal.analysis.correlation import ExteriorCorrelation, StrongCorrelation
from photocal.analysis.method import MethodCheck
from photocal.analysis.robust import apart
from photocal.analysis.systematic_errors.scatter import AssumedSigma
from photocal.block.model import InputFile, fingerprint
from photocal.findings.finding import Finding
from photocal.results.folder import RESULT, read_json, read_result
from photocal.results.result import Result

ANALYSIS = "analysis.json"
SCHEMA = "photocal.analysis/1"


@dataclass(frozen=True)
class TestRecord:
    """An F test; without a statistic it was infinite."""

    kind: str
    parameters: tuple[str, ...]
    statistic: float | None
    critical: float
    significant: bool


@dataclass(frozen=True)
class EffectRecord:
    """Effect of parameters over the format, px; none where the distortion folds without them."""

    parameters: tuple[str, ...]
    largest_px: float | None
    remaining_largest_px: float | None


@dataclass(frozen=True)
class FinalComponents:
    """Principal components of the parameters that the removal rule keeps."""

    names: tuple[str, ...]
    eigenvalues: tuple[float, ...]
    percent: tuple[float, ...]
    cumulative_percent: tuple[float, ...]


@dataclass(frozen=True)
class ComponentsRecord:
    """Principal components and what is proposed."""

    final: FinalComponents
    remarks: tuple[Finding, ...]


@dataclass(frozen=True)
class LeftOutRecord:
    """The adjustment without one parameter."""

    parameter: str
    c: float
    change_of_c: float
    sigma0_squared: float | None
    check_rmse_m: tuple[float, float, float] | None


@dataclass(frozen=True)
class CameraRecord:
    """Everything about the parameters of one camera."""

    variance_factor_of_tests: float
    significance: tuple[TestRecord, ...]
    effects: tuple[EffectRecord, ...]
    correlations: tuple[StrongCorrelation, ...]
    correlations_with_exterior: tuple[ExteriorCorrelation, ...]
    components: ComponentsRecord
    left_out: tuple[LeftOutRecord, ...]


@dataclass(frozen=True)
class Removal:
    """Images that were left out together."""

    images: tuple[str, ...]


@dataclass(frozen=True)
class JackknifeRecord:
    """Second opinions on standard deviations, by parameter; none where there were too few images.

    standard_error, standard_error_corrected: with images left out, and the same after the corrections.
    """

    standard_error: dict[str, float | None]
    standard_error_corrected: dict[str, float | None]
    left_out: tuple[Removal, ...]
    sandwich: dict[str, float | None] = field(default_factory=dict)
    bootstrap: dict[str, float | None] | None = None

    def others(self, parameter: str, formal: float) -> tuple[float | None, float | None]:
        """Sandwich and bootstrap where one of them differs from the formal one by more than a third."""
        pair = self.sandwich.get(parameter), (self.bootstrap or {}).get(parameter)
        return pair if any(apart(formal, one) for one in pair) else (None, None)

    def largest(self, parameter: str, formal: float) -> tuple[float, str]:
        """Largest opinion that is more than a third above the formal one, and whose it is; else "formal".

        Leaving out images stands in for the sandwich where there are too few of them.
        """
        others = {
            "sandwich": self.sandwich.get(parameter),
            "bootstrap": (self.bootstrap or {}).get(parameter),
        }
        if others["sandwich"] is None:
            others = {"jackknife": self.standard_error.get(parameter), **others}
        sigma, whose = max((one or 0.0, name) for name, one in others.items())
        return (sigma, whose) if sigma > formal and apart(formal, sigma) else (formal, "formal")


@dataclass(frozen=True)
class ExteriorDifference:
    """Original less adjusted exterior orientation over the images that have both.

    mean_m, rmse_m: X, Y, Z in the local frame of the block (east, north, up where it has a reference system).
    mean_arcsec, rmse_arcsec: omega, phi, kappa.
    """

    images: int
    mean_m: tuple[float, ...]
    rmse_m: tuple[float, ...]
    mean_arcsec: tuple[float, ...]
    rmse_arcsec: tuple[float, ...]


@dataclass(frozen=True)
class StoredAnalysis:
    """The content of `analysis.json` as far as a certificate needs it.

    result_sha256: digest of the result.json that it belongs to.
    alpha, correlation_threshold: level of the F tests, and correlation from which pairs are named.
    findings: hidden errors, worst first.
    cameras: by name; None for one without estimated parameters.
    observation_sigma: of the image coordinates, assumed and found, in the unit of the image plane.
    exterior_difference: orientations of the positioning system less the adjusted ones.
    bootstrap_draws: how often images were drawn.
    """

    schema: str
    result_sha256: str
    alpha: float
    correlation_threshold: float
    findings: tuple[Finding, ...]
    cameras: dict[str, CameraRecord | None]
    observation_sigma: AssumedSigma
    jackknife: dict[str, JackknifeRecord]
    methods: tuple[MethodCheck, ...]
    exterior_difference: ExteriorDifference | None = None
    bootstrap_draws: int = 0


@dataclass(frozen=True, eq=False)
class Run:
    """Everything that a certificate says about an adjustment.

    files: the files of the folder themselves, with their SHA-256.
    analysis: what `photocal analyse` found; None when it was not asked.
    """

    result: Result
    files: tuple[InputFile, ...]
    analysis: StoredAnalysis | None = None

    def stated(self, camera_id: str, parameter: str = "c") -> tuple[float, str]:
        """Standard deviation that a client is told: scaled where the global test is rejected, or larger.

        returns: it, and whose it is: see `JackknifeRecord.largest`; "held" for what was not estimated.
        """
        if parameter not in self.result.cameras[camera_id].free:
            return 0.0, "held"
        formal = (self.result.scale or 1.0) * self.result.cameras[camera_id].sigma_of(parameter)
        record = self.analysis.jackknife.get(camera_id) if self.analysis else None
        return (formal, "formal") if record is None else record.largest(parameter, formal)


def read_run(folder: Path) -> Run:
    """Read a result with the analysis that `photocal analyse` added; errors as for `read_result`."""
    result = read_result(folder)
    path = folder / ANALYSIS
    if not path.is_file():
        return Run(result, result.files)
    stored = read_json(path, StoredAnalysis, SCHEMA, "run `photocal analyse` again")
    # That of an earlier run would say something else.
    if stored.result_sha256 != fingerprint(folder / RESULT).sha256:
        raise InputMalformedError(
            "belongs to another run: result.json has changed since",
            where=path,
            remedy="run `photocal analyse` again",
        )
    return Run(result, (*result.files, fingerprint(path)), stored)
