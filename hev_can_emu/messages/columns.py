"""The columns of the codec's tables: what stands where in a row of a message or a signal."""

# Columns of Codec.messages, one row per message.
M_ID = 0
M_FLAGS = 1  # EXTENDED, FD, BRS
M_LENGTH = 2  # bytes in the database
M_WIRE_LENGTH = 3  # bytes on the bus
M_FIRST = 4  # first signal
M_COUNT = 5  # number of signals
M_QUICK = 6  # word order of hev_can_emu.messages.quick, 0: not for its kernels
M_GUARDS = 7  # first signal that the protection writes, in Codec.lists
M_GUARD_COUNT = 8
M_COLUMNS = 9

# Columns of Codec.signals, one row per signal.
S_BYTE = 0  # byte of the least significant bit
S_BIT = 1  # its place in that byte
S_STEP = 2  # to the byte of the next higher bits: +1 little-endian, -1 big-endian
S_LENGTH = 3
S_KIND = 4
S_HAS_NA = 5
S_NA = 6  # bit pattern
S_INITIAL = 7  # bit pattern
S_PARENT = 8  # multiplexer signal, or -1
S_RANGES = 9  # first pair in Codec.lists
S_RANGE_COUNT = 10
S_EXTRA = 11  # first labelled raw value outside the range, in Codec.lists
S_EXTRA_COUNT = 12
S_ORDER = 13  # the signal to encode at this place: multiplexers before what they select
S_PROTECTED = 14  # 1: written by the message's protection, not by a value
S_MISSING = 15  # bit pattern that NaN is sent as
S_COLUMNS = 16

# Columns of Codec.scaling, one row per signal.
F_SCALE = 0
F_OFFSET = 1
F_LOW = 2  # raw
F_HIGH = 3  # raw
F_COLUMNS = 4
