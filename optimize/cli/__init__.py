"""Commands of `moflock` that search and validate, registered as entry points."""
