"""Readers of animated scenes, ray tracing and pose sampling: scenes in, datasets out."""
