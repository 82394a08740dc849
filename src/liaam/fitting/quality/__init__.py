"""What a solution is worth: its status, its uncertainty, and the evidence that it is right."""
