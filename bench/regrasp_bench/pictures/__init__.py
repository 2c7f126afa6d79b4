"""Pictures that explain the method, made by ``regrasp-bench pictures``."""
