"""Named sets of a policy's parameters, their files and their bounds."""
