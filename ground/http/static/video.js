// A camera's video by WebRTC, as ground/http/video.py answers it.

import { address } from "./settings.js";
import { t } from "./words.js";

const GATHERED_MS = 1000;

/** This browser can show H.264 that comes so. */
export const canPlay = Boolean(window.RTCRtpReceiver?.getCapabilities("video")?.codecs.some((each) => each.mimeType === "video/H264") && HTMLVideoElement.prototype.requestVideoFrameCallback);

/**
 * Play until the connection ends; throws where it cannot be made, and the gateway's words where it refuses.
 * @param {string} path @param {AbortSignal} signal @param {HTMLVideoElement} video
 */
export async function playVideo(path, signal, video) {
  const peer = new RTCPeerConnection();
  try {
    const { receiver } = peer.addTransceiver("video", { direction: "recvonly" });
    if ("jitterBufferTarget" in receiver) receiver.jitterBufferTarget = 0; // what is late is of no use here
    video.srcObject = new MediaStream([receiver.track]);
    await peer.setLocalDescription(await peer.createOffer());
    await gathered(peer);
    const body = JSON.stringify({ type: "offer", sdp: peer.localDescription?.sdp });
    const answer = await fetch(address(path), { method: "POST", headers: { "Content-Type": "application/json" }, body, signal });
    const told = await answer.json();
    if (!answer.ok) throw new Error(told.error.text);
    await peer.setRemoteDescription(told);
    video.play().catch(() => {}); // it was closed meanwhile
    await ended(peer, signal);
  } finally {
    peer.close();
  }
}

/** Wait until all addresses of this browser are in its offer. @param {RTCPeerConnection} peer */
function gathered(peer) {
  return new Promise((resolve) => {
    setTimeout(resolve, GATHERED_MS, null);
    peer.onicegatheringstatechange = () => peer.iceGatheringState === "complete" && resolve(null);
    if (peer.iceGatheringState === "complete") resolve(null);
  });
}

/** @param {RTCPeerConnection} peer @param {AbortSignal} signal @returns {Promise<void>} */
function ended(peer, signal) {
  return new Promise((resolve, reject) => {
    const look = () => {
      if (["failed", "closed"].includes(peer.connectionState)) reject(new Error(t("camera.no-video")));
    };
    signal.addEventListener("abort", () => resolve());
    peer.onconnectionstatechange = look;
    if (signal.aborted) resolve(); // while the answer was taken
    look();
  });
}
