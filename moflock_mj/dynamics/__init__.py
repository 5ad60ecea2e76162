"""What moves the drones: point masses, or MuJoCo bodies with rotors."""
