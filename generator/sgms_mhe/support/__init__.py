"""What every stage stands on: errors a user can act on, whole files, folders of the product, tables, the C compiler."""
