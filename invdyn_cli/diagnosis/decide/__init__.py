"""The statements about what was found: named, ambiguous, refused or not observable, with sizes and gains."""
