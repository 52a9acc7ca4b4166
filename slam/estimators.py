"""All filters, by the short name that command line and recording use."""

from slam.dual_fastslam import DUAL_FASTSLAM
from slam.ekf_slam import EKF_SLAM
from slam.fastslam1 import FASTSLAM1
from slam.fastslam2 import FASTSLAM2
from slam.types import Estimator

ESTIMATORS: dict[str, Estimator] = {e.key: e for e in (DUAL_FASTSLAM, FASTSLAM2, FASTSLAM1, EKF_SLAM)}
"""In the order in which people see them."""
