"""Whether what is reported holds, on specimens that share no code with the package."""
