"""The server side: ArduPilot- and PX4-like vehicles on our bodies."""
