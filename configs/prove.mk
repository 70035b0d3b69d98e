# The proof on concealed effects: cases made and sealed on the virtual press, diagnosed by the command, then opened.
# A run that was interrupted goes on where it stopped; RUNS/prove removed, it begins anew. The final seed is for
# `make prove` alone; whatever is tuned is tuned on prove-quick.

PROOF ?= sample_data/proof

.PHONY: prove-real
prove-real: real ## Add known effects to real recordings, sealed, and ask (an hour; RECORDINGS=...; result in docs/evidence)
	$(BIN)/python -m tests.prove.spiked $(RUNS)/prove-real $(REAL) --report docs/evidence/spiked.json

.PHONY: prove prove-quick
prove: $(VENV)/.installed ## Prove the diagnosis on 240 sealed cases (an hour; result in sample_data/proof)
	$(BIN)/python -m tests.prove $(RUNS)/prove --seed final --report $(PROOF)

prove-quick: $(VENV)/.installed ## Prove the diagnosis on a handful of other cases (5 minutes; result in runs/prove-quick/report)
	$(BIN)/python -m tests.prove $(RUNS)/prove-quick --quick
