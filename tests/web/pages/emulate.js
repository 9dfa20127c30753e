// A headset of Meta's emulator, before the page looks for one.
const device = new IWER.XRDevice(IWER.metaQuest3, { stereoEnabled: true });
device.installRuntime({ forceInstall: true });
device.position.set(0, 1.2, 0);
window.headset = device;
