"""What is drawn: pillars by cell and dose class, copies, the field around them, marks and labels."""
