import { computed, signal } from "@preact/signals";
import { api, told, type Caller } from "../net/api";

/** Who is signed in; null: nobody; undefined: not known yet. */
export const caller = signal<Caller | null | undefined>(undefined);

const RANKS = ["viewer", "operator", "maintainer"];

function atLeast(role: string) {
  return computed(() => RANKS.indexOf(caller.value?.role ?? "") >= RANKS.indexOf(role));
}

/** May scan. The service decides; this only shows what there is no use in showing to others. */
export const operates = atLeast("operator");
/** May acknowledge faults and calibrate. */
export const maintains = atLeast("maintainer");

/** Asks who is signed in. */
export async function askSession(): Promise<void> {
  caller.value = (await told(api.GET("/api/session"))).caller;
}

/** Signs in by a token. */
export async function signIn(token: string): Promise<void> {
  caller.value = (await told(api.POST("/api/session", { body: { token } }))).caller;
}

/** Signs out of this browser. */
export async function signOut(): Promise<void> {
  await told(api.DELETE("/api/session"));
  await askSession();
}
