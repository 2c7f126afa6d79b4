"""Layer 4: where behaviour cloning and reinforcement learning on the environments and datasets belong."""
