"""Looks of a scene, and pictures of it."""
