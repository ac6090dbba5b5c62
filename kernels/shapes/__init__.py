"""Contact between surfaces of analytic form: shapes, and where two of them meet."""
