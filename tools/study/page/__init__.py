"""The page of a study as Markdown. Every number comes from the study or from the paper; none is typed here."""
