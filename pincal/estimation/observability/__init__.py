"""What measurements determine: rank, observability indices, weak pairs, gauge freedoms."""
