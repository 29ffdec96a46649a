"""Studies: what forces depend on, which parameters measurements fit, what segmentation costs."""

from myork.studies.identify import identify
from myork.studies.sensitivity import sensitivity
from myork.studies.uncertainty import uncertainty

__all__ = ["identify", "sensitivity", "uncertainty"]
