"""From a desired velocity to four rotor thrusts, and the design of the gains."""
