"""What the checks say about an input: good, doubtful or unusable, with what to do about it."""
