"""Where simulation and recording part, which physics is missing, and the model that has it."""

from trackres_ros.diagnosis.bases import load_base
from trackres_ros.diagnosis.diagnose import Diagnosis, diagnose, read_recordings

__all__ = ["Diagnosis", "diagnose", "load_base", "read_recordings"]
