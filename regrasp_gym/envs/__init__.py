"""Gymnasium environments. `gymnasium.make` finds them by their ids once `regrasp_gym` is imported."""
