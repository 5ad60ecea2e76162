"""Tables, figures and pages that present results."""
