"""The open face benchmark: problems of one head that any code can take, their converged answers, and their scores."""
