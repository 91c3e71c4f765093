"""Small networks, each of one kind, beside the two that ship: the codec is held against cantools on all."""

from __future__ import annotations

from pathlib import Path

SHIPPED = Path(__file__).parents[2] / "dbc"
FRAME_FORMAT = (
    'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN",'
    + ",".join(['"reserved"'] * 12)
    + ',"StandardCAN_FD","ExtendedCAN_FD";\nBA_DEF_DEF_ "VFrameFormat" "StandardCAN";\n'
)


def _network(messages: str, tail: str = "") -> str:
    return f'VERSION ""\nNS_ :\nBS_:\nBU_: A B\n\n{messages}\n{tail}'


TEXTS = {
    "little endian, unsigned": _network(
        "BO_ 256 L: 8 A\n"
        ' SG_ S0 : 0|12@1+ (0.1,0) [0|409.4] "Nm" B\n SG_ S1 : 12|13@1+ (1,-4000) [0|0] "rpm" B\n'
        ' SG_ S2 : 25|7@1+ (0.5,-40) [-40|23] "degC" B\n SG_ S3 : 32|32@1+ (0.001,0) [0|0] "" B\n'
    ),
    "big endian, signed": _network(
        "BO_ 256 G: 8 A\n"
        ' SG_ S0 : 7|12@0- (0.25,0) [-500|500] "Nm" B\n SG_ S1 : 11|20@0- (1,7) [0|0] "" B\n'
        ' SG_ S2 : 39|1@0+ (1,0) [0|1] "" B\n SG_ S3 : 38|15@0- (-0.5,3) [0|0] "V" B\n'
        ' SG_ S4 : 55|16@0- (0.01,0) [-300|300] "A" B\n'
    ),
    "both byte orders in one message": _network(
        "BO_ 256 X: 7 A\n"
        ' SG_ S0 : 0|10@1+ (1,0) [0|0] "" B\n SG_ S1 : 23|12@0- (0.5,0) [0|0] "" B\n'
        ' SG_ S2 : 32|9@1- (3,-1) [0|0] "" B\n SG_ S3 : 55|6@0+ (1,0) [0|0] "" B\n'
    ),
    "floating point": _network(
        'BO_ 256 F: 8 A\n SG_ S0 : 0|32@1- (1,0) [0|0] "" B\n SG_ S1 : 39|32@0- (2,1) [0|0] "" B\n'
        'BO_ 257 D: 8 A\n SG_ S2 : 7|64@0- (0.1,0) [0|0] "" B\n'
        'BO_ 258 H: 4 A\n SG_ S3 : 0|16@1- (1,0) [0|0] "" B\n SG_ S4 : 23|16@0- (1,0) [0|0] "" B\n',
        "SIG_VALTYPE_ 256 S0 : 1;\nSIG_VALTYPE_ 256 S1 : 1;\nSIG_VALTYPE_ 257 S2 : 2;\n"
        "SIG_VALTYPE_ 258 S3 : 1;\nSIG_VALTYPE_ 258 S4 : 1;\n",
    ),
    "multiplexed": _network(
        'BO_ 256 M: 8 A\n SG_ Mux M : 0|4@1+ (1,0) [0|15] "" B\n'
        ' SG_ X0 m0 : 8|16@1- (0.1,0) [0|0] "V" B\n SG_ X1 m1 : 15|24@0+ (1,0) [0|0] "" B\n'
        ' SG_ X2 m2 : 8|8@1+ (1,0) [0|0] "" B\n SG_ S : 40|24@1+ (1,0) [0|0] "" B\n'
    ),
    "extended multiplexing": _network(
        'BO_ 256 E: 8 A\n SG_ Outer M : 0|3@1+ (1,0) [0|7] "" B\n SG_ Inner m1M : 8|3@1+ (1,0) [0|7] "" B\n'
        ' SG_ Leaf m2 : 16|12@1- (0.5,0) [0|0] "" B\n SG_ Other m5 : 16|16@1+ (1,0) [0|0] "" B\n',
        "SG_MUL_VAL_ 256 Inner Outer 1-1, 3-4;\nSG_MUL_VAL_ 256 Leaf Inner 0-2, 5-7;\n"
        "SG_MUL_VAL_ 256 Other Outer 5-5;\n",
    ),
    "CAN FD, 64 bytes": _network(
        "BO_ 256 W: 64 A\n"
        + "".join(
            f' SG_ L{n} : {8 * n}|{5 + n}@1{"+-"[n % 2]} ({0.5 * (n + 1)},{-n}) [0|0] "" B\n'
            for n in range(0, 32, 8)
        )
        + "".join(
            f' SG_ B{n} : {8 * n + 7}|{9 + n // 4}@0{"+-"[n // 4 % 2]} (1,0) [0|0] "" B\n'
            for n in range(32, 64, 4)
        ),
        FRAME_FORMAT + 'BA_ "VFrameFormat" BO_ 256 14;\n',
    ),
    "CAN FD, extended, 20 bytes": _network(
        "BO_ 2566848513 V: 20 A\n"
        ' SG_ S0 : 3|33@0- (1,0) [0|0] "" B\n SG_ S1 : 60|17@1+ (0.1,100) [0|0] "" B\n'
        ' SG_ S2 : 96|64@1+ (1,0) [0|0] "" B\n',
        FRAME_FORMAT + 'BA_ "VFrameFormat" BO_ 2566848513 15;\n',
    ),
    "flags and codes": _network(
        "BO_ 256 C: 3 A\n"
        + "".join(f' SG_ Flag{n} : {n}|1@1+ (1,0) [0|1] "" B\n' for n in range(8))
        + ' SG_ Mode : 8|4@1+ (1,0) [0|14] "" B\n SG_ Gear : 15|4@0- (1,0) [-7|7] "" B\n'
        + "BO_ 257 Empty: 3 A\nBO_ 258 Nothing: 0 A\n",
        'VAL_ 256 Mode 0 "Off" 1 "On" 15 "NotAvailable" ;\nVAL_ 256 Gear -8 "SNA" 0 "N" -1 "R" ;\n',
    ),
    "as in trucks": _network(
        "BO_ 2566844926 EEC1: 8 A\n"
        ' SG_ Torque : 16|8@1+ (1,-125) [-125|125] "%" B\n'
        ' SG_ Speed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" B\n'
        ' SG_ Source : 40|8@1+ (1,0) [0|255] "" B\n',
        'VAL_ 2566844926 Torque 255 "Not available" ;\nVAL_ 2566844926 Speed 65535 "Not available" ;\n',
    ),
    "long integers": _network(
        'BO_ 256 I: 8 A\n SG_ S0 : 7|64@0- (1,0) [0|0] "" B\n'
        'BO_ 257 J: 8 A\n SG_ S1 : 0|53@1+ (1,0) [0|0] "" B\n SG_ S2 : 53|11@1- (1,0) [0|0] "" B\n'
        'BO_ 258 K: 8 A\n SG_ S3 : 0|51@1- (0.5,1) [0|0] "" B\n',
    ),
    "ours": (SHIPPED / "hev.dbc").read_text(),
    "the example's": (SHIPPED / "examples" / "alpin.dbc").read_text(encoding="utf-8"),
}
