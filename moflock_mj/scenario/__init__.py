"""What is flown, declared and checked: no computation."""
