"""Vehicle dynamics: point masses, or MuJoCo rigid bodies with rotors."""
