"""The parts of ci/gpu-day: pack (prepare), runner and tasks (run), tables."""


class Problem(Exception):
    """A message for the user."""
