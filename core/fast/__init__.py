"""The `fast` method: the order of its steps, which candidates come first, and how they are refined."""
