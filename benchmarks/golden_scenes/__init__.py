"""Golden scenes by subject: small scenes whose results must not change by one bit."""
