"""Pages of the documents that are made from the code, and what turns all of them into a site."""
