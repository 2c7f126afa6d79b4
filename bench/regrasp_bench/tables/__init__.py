"""Tables and measurements, one module each."""
