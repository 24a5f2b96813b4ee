"""Models, lights and poses in, shaded pictures out."""
