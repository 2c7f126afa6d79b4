"""Learning on top of the environments and datasets: behaviour cloning, reinforcement learning, evaluation."""
