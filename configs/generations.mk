# The paper's workflow (its Fig. 2) on the virtual printer: design, print, measure, align, calibrate, correct, print again.
#   make generations TARGET=cin|air|lens-array [SEED=1] [GENERATIONS=2] [DIAGNOSE=1] [START=parameters.yaml]
# runs/generations/TARGET-SEED/gK holds generation K; g0 is the calibration print of the unmodified target. The seed is
# that of the recordings' noise and of AIR's surface. Each step is a file, so an interrupted run goes on where it stopped.
#
# Every recording is aligned to the original target, since that is what each print is meant to show; written map and
# recording then lie on one grid. Calibration pairs them, from generation 1 on all generations jointly. The recording's
# lateral scale is trusted (--distortion rigid): a part that is too small must not be stretched to fit.

TARGET ?= cin
SEED ?= 1
GENERATIONS ?= 2
START ?= configs/paper-defaults.yaml
GENERATION_DESIGN_cin := --size-um 50 --pitch-um 0.25 --margin-um 8
GENERATION_DESIGN_air := --size-um 100 --pitch-um 0.4 --margin-um 10 --seed $(SEED)
GENERATION_DESIGN_lens-array := --size-um 60 --pitch-um 0.3 --margin-um 8
GENERATION_FIELD_cin := 80
GENERATION_FIELD_air := 140
GENERATION_FIELD_lens-array := 95

# DIAGNOSE=1 lets each generation learn from the diagnosis too: what is missing goes into the parameter file.
GENERATION := $(RUNS)/generations/$(TARGET)-$(SEED)$(if $(DIAGNOSE),-diagnosed)
GENERATION_PROCESS := $(if $(DIAGNOSE),extended,process)
GENERATION_NUMBERS := $(shell seq 0 $(GENERATIONS))

.PHONY: generations
generations: $(foreach k,$(GENERATION_NUMBERS),$(GENERATION)/g$(k)/score.json $(GENERATION)/g$(k)/written.stl) ## Print, measure, calibrate, correct, print again on the virtual press (TARGET=cin|air|lens-array, DIAGNOSE=1)
	@$(BIN)/python -m tests.bench.generations $(GENERATION) $(TARGET)

$(GENERATION)/target.tif: | $(VENV)/.installed
	@test -n "$(GENERATION_DESIGN_$(TARGET))" || { echo "error: TARGET=$(TARGET): allowed are cin, air, lens-array"; exit 1; }
	@mkdir -p $(@D)
	$(DLW) design $(TARGET) $(GENERATION_DESIGN_$(TARGET)) -o $@ --overwrite

$(GENERATION)/microscope.yaml: configs/microscope.yaml
	@mkdir -p $(@D)
	{ cat $<; echo "field_um: $(GENERATION_FIELD_$(TARGET))"; } > $@

$(GENERATION)/g0/written.tif: $(GENERATION)/target.tif
	@mkdir -p $(@D)
	cp $< $@

$(GENERATION)/%/written.stl: $(GENERATION)/%/written.tif
	$(DLW) export-stl $< -o $@ --overwrite

$(GENERATION)/%/printed.tif: $(GENERATION)/%/written.tif configs/press.yaml
	$(BIN)/python -m tests.press print $< -p configs/press.yaml -o $@ --overwrite

$(GENERATION)/g%/recording.tif: $(GENERATION)/g%/printed.tif $(GENERATION)/microscope.yaml
	$(BIN)/python -m tests.press measure $< -p $(GENERATION)/microscope.yaml -o $@ --seed $(SEED)$* --truth $(@D)/truth.yaml --overwrite

$(GENERATION)/%/aligned.tif: $(GENERATION)/%/recording.tif $(GENERATION)/target.tif
	$(DLW) align $^ -o $@ --distortion rigid --report $(@D)/align.yaml --overwrite

$(GENERATION)/%/score.json: $(GENERATION)/target.tif $(GENERATION)/%/aligned.tif
	$(DLW) score $^ --part-only --json $@ --plot $(@D)/score.png --overwrite --quiet

# Generation K is written from what all generations before it have taught: $(1) = K, $(2) = K - 1, $(3) = 0 ... K - 1.
define generation
$(GENERATION)/g$(2)/process.yaml: $(START) $(foreach j,$(3),$(GENERATION)/g$(j)/written.tif $(GENERATION)/g$(j)/aligned.tif)
	$$(DLW) calibrate $(foreach j,$(3),--pair $(GENERATION)/g$(j)/written.tif $(GENERATION)/g$(j)/aligned.tif) \
	  -p $$< -o $$@ --report $$(@D)/calibration.yaml --overwrite

$(GENERATION)/g$(2)/extended.yaml: $(GENERATION)/g$(2)/process.yaml
	$$(DLW) diagnose $(foreach j,$(3),--pair $(GENERATION)/g$(j)/written.tif $(GENERATION)/g$(j)/aligned.tif) -p $$< \
	  -o $$(@D)/diagnosis.yaml --params-out $$@ --report $$(@D)/diagnosis.html --no-advice --overwrite

$(GENERATION)/g$(1)/written.tif: $(GENERATION)/target.tif $(GENERATION)/g$(2)/$(GENERATION_PROCESS).yaml
	@mkdir -p $$(@D)
	$$(DLW) precompensate $$< -p $(GENERATION)/g$(2)/$(GENERATION_PROCESS).yaml --undecided print -o $$@ \
	  --report $$(@D)/precompensation.yaml --overwrite
endef
$(foreach k,$(filter-out 0,$(GENERATION_NUMBERS)),$(eval \
  $(call generation,$(k),$(shell expr $(k) - 1),$(shell seq 0 $$(expr $(k) - 1)))))

.PRECIOUS: $(GENERATION)/%/written.tif $(GENERATION)/%/printed.tif $(GENERATION)/%/aligned.tif $(GENERATION)/g%/recording.tif
