"""Base of every stage: errors a user can act on, whole files, folders of the product, tables, the C compiler."""
