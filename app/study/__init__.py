"""Monte Carlo studies: `dualslam study NAME`.  One file a study, one line here for each.

A study is a frozen dataclass: its fields are its options, its docstring is its help, calling it runs it.
"""

from __future__ import annotations

from app.study.association import AssociationStudy
from app.study.extraction import ExtractionStudy
from app.study.log_error import LogError
from app.study.orthogonality import OrthogonalityStudy
from app.study.paper_table import PaperTable

STUDIES: dict[str, type] = {
    "paper-table": PaperTable,
    "log-error": LogError,
    "association": AssociationStudy,
    "extraction": ExtractionStudy,
    "orthogonality": OrthogonalityStudy,
}
