"""What a scene looks like, and pictures of it."""
