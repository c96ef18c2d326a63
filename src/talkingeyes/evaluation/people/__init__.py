"""Generated gaze against recorded people in conversation: same detector, same measures, person-to-person units."""
