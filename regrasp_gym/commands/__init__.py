"""The package's commands, one module each."""
