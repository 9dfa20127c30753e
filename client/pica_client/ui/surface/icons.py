"""The icons of the surface: Font Awesome 6 Free Solid (SIL OFL 1.1), which imgui-bundle ships."""

from imgui_bundle import icons_fontawesome_6 as _awesome

FACE = _awesome.ICON_FA_FACE_SMILE
FACE_OFF = _awesome.ICON_FA_EYE_SLASH
VOICE = _awesome.ICON_FA_MICROPHONE
VOICE_OFF = _awesome.ICON_FA_MICROPHONE_SLASH
FREEZE = _awesome.ICON_FA_SNOWFLAKE
LAYOUT = _awesome.ICON_FA_TABLE_CELLS_LARGE
RECORD = _awesome.ICON_FA_CIRCLE
STOP = _awesome.ICON_FA_SQUARE
PICTURE = _awesome.ICON_FA_CAMERA
PEOPLE = _awesome.ICON_FA_USER_GROUP
SETTINGS = _awesome.ICON_FA_GEAR
HELP = _awesome.ICON_FA_CIRCLE_QUESTION
LEAVE = _awesome.ICON_FA_PHONE_SLASH
CLOSE = _awesome.ICON_FA_XMARK
PIN = _awesome.ICON_FA_THUMBTACK
CHART = _awesome.ICON_FA_CHART_SIMPLE
LOCK = _awesome.ICON_FA_LOCK
COPY = _awesome.ICON_FA_COPY
CHECK = _awesome.ICON_FA_CHECK
WARNING = _awesome.ICON_FA_TRIANGLE_EXCLAMATION
WATCHING = _awesome.ICON_FA_EYE
MORE = _awesome.ICON_FA_ELLIPSIS_VERTICAL
RESET = _awesome.ICON_FA_ROTATE_LEFT
SPEAKING = _awesome.ICON_FA_WAVE_SQUARE
OPEN = _awesome.ICON_FA_CHEVRON_DOWN
