"""Video to observations: frames and sound of a file, landmarks of a face, shots of one visible face."""
