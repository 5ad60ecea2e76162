"""Flight control from a desired velocity to four rotor thrusts, and the design of its gains."""
