"""A run with the analysis that was stored beside it: what a certificate is made of."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from photocal.analysis.outcome import ANALYSIS, SCHEMA, Analysis
from photocal.base.arrays import as_plain
from photocal.base.codec import from_plain
from photocal.base.errors import InputMalformedError
from photocal.block.model import InputFile, fingerprint
from photocal.block.results.folder import RESULT, read_json, read_result
from photocal.block.results.result import Result

_AGAIN = "run `photocal analyse` again"
# What a certificate repeats of an analysis, and of the parts of its parts; empty: all of it.
_SCHEMA_CERTIFIED = "photocal.analysis/1"
_COMPONENTS = dict.fromkeys(("names", "eigenvalues", "percent", "cumulative_percent"), ())
_CAMERA: dict[str, Any] = {
    "variance_factor_of_tests": (),
    "significance": dict.fromkeys(("kind", "parameters", "statistic", "critical", "significant"), ()),
    "effects": dict.fromkeys(("parameters", "largest_px", "remaining_largest_px"), ()),
    "correlations": (),
    "correlations_with_exterior": (),
    "components": {"final": _COMPONENTS, "remarks": ()},
    "left_out": dict.fromkeys(("parameter", "c", "change_of_c", "sigma0_squared", "check_rmse_m"), ()),
}
_OPINIONS: dict[str, Any] = {
    "standard_error": (),
    "standard_error_corrected": (),
    "left_out": {"images": ()},
    "sandwich": (),
    "bootstrap": (),
}


@dataclass(frozen=True, eq=False)
class AnalysedRun:
    """Everything that a certificate says about an adjustment.

    files: the files of the folder themselves, with their SHA-256.
    analysis: what `photocal analyse` found; None when it was not asked.
    """

    result: Result
    files: tuple[InputFile, ...]
    analysis: Analysis | None = None

    def stated(self, camera_id: str, parameter: str = "c") -> tuple[float, str]:
        """Standard deviation as reported to a client: scaled where the global test is rejected, or larger.

        returns: it, and whose it is: see `Opinions.largest`; "held" for what was not estimated.
        """
        if parameter not in self.result.cameras[camera_id].free:
            return 0.0, "held"
        formal = (self.result.scale or 1.0) * self.result.cameras[camera_id].sigma_of(parameter)
        opinions = self.analysis.jackknife.get(camera_id) if self.analysis else None
        return (formal, "formal") if opinions is None else opinions.largest(parameter, formal)


def read_run(folder: Path) -> AnalysedRun:
    """Read a result with the analysis that `photocal analyse` added; errors as for `read_result`."""
    result = read_result(folder)
    path = folder / ANALYSIS
    if not path.is_file():
        return AnalysedRun(result, result.files)
    content = read_json(path, SCHEMA, _AGAIN)
    malformed = InputMalformedError.at(path)
    try:
        stored: Analysis = from_plain(Analysis, content)
    except ValueError as lacking:
        raise malformed(str(lacking), _AGAIN) from None
    # That of an earlier run would say something else.
    if stored.result_sha256 != fingerprint(folder / RESULT).sha256:
        raise malformed("belongs to another run: result.json has changed since", _AGAIN)
    return AnalysedRun(result, (*result.files, fingerprint(path)), stored)


def certified_analysis(analysis: Analysis | None) -> dict[str, Any] | None:
    """Give what a certificate repeats of an analysis."""
    if analysis is None:
        return None
    parts: dict[str, Any] = {
        **dict.fromkeys(("result_sha256", "alpha", "correlation_threshold", "findings"), ()),
        "cameras": dict.fromkeys(analysis.cameras, _CAMERA),
        "observation_sigma": (),
        "jackknife": dict.fromkeys(analysis.jackknife, _OPINIONS),
        **dict.fromkeys(("methods", "exterior_difference", "bootstrap_draws", "c_by_height"), ()),
    }
    return {"schema": _SCHEMA_CERTIFIED, **_only(as_plain(analysis), parts)}


def _only(value: Any, parts: Any) -> Any:
    if isinstance(value, list):
        return [_only(element, parts) for element in value]
    return {key: _only(value[key], parts[key]) for key in parts} if parts and value else value
