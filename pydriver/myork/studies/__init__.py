"""Studies: which parameters measurements fit, what segmentation costs."""

from myork.studies.identify import identify
from myork.studies.uncertainty import uncertainty

__all__ = ["identify", "uncertainty"]
