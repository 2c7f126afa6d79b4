"""Bodies that may touch: collision models, and how far configurations keep clear of contact."""
