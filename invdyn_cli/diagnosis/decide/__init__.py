"""What may be said of what was found: named, ambiguous, refused or not to be seen, with sizes and gains."""
