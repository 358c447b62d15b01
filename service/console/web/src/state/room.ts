import { signal } from "@preact/signals";
import { api, told, type Room } from "../net/api";

/** What does not change while the service runs: the workspace, the arm's shape, what is set. Null: not asked yet. */
export const room = signal<Room | null>(null);

/** Asks for it. */
export async function askRoom(): Promise<void> {
  const asked: unknown = await told(api.GET("/api/cell/room"));
  room.value = asked as Room; // the client's types make lists of any length of corners
}
