"""Scenes: functions of a seed and a configuration, pure data."""
