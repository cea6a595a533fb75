"""The compiled soft tissue and life of a person: MuJoCo engine plugins in C (`tissue/c/`), and what finds, loads and
reads them."""
