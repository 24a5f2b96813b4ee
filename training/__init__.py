"""Datasets in, fitted models and ONNX out."""
