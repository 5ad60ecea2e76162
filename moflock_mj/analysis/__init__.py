"""Questions answered by flying: step response, identification, target tracking, verification."""
