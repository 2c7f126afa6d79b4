"""Objects to be manipulated."""

from regrasp_gym.objects.model import ObjectModel, solid
from regrasp_gym.objects.ycb import OBJECTS

__all__ = ["OBJECTS", "ObjectModel", "solid"]
