"""From video to what a corpus holds: frames and sound of a file, landmarks of a face, shots of one visible face."""
