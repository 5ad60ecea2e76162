"""The commands of `moflock` that search and validate; registered by entry point."""
