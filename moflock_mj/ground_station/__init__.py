"""The ground station: remote vehicles, their links, and the commands sent to them."""
