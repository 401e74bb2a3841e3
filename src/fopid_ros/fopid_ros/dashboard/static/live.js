// The connection to the dashboard's server: what it tells, by itself and as long as it is there.

import { mayChange, rememberToken } from "./page/ask.js";

const AGAIN_AFTER = 1000;  // [ms]

// Connect, and again whenever the connection is lost.
export function connect({ onMessage, onOpen, onLost }) {
  rememberToken();
  addEventListener("hashchange", async () => {
    rememberToken();
    onOpen(await mayChange());
  });
  const open = () => {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
    socket.onopen = async () => onOpen(await mayChange());
    socket.onmessage = (event) => onMessage(JSON.parse(event.data));
    socket.onclose = () => {
      onLost();
      setTimeout(open, AGAIN_AFTER);
    };
  };
  open();
}
