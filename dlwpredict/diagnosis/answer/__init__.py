"""The answer: classes, sides, advice, and the words and figures of diagnosis.yaml."""
