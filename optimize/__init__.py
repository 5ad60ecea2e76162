"""The search over the policy's parameters."""
