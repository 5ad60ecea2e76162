"""Real autopilot programs on our rigid bodies: their motors move them, our sensors tell them."""
