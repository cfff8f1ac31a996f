"""What target phases are worth before anything is made of them."""
